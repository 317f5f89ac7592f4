"""The ECG that a configuration names, where no peer sends it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from dvf_ig.intake.live import EcgFieldConfig, EcgStreamConfig, LiveConfig
from dvf_ig.live.timed import LiveEvent

from .gather import EcgReader, gathered
from .lsl import LslEcg
from .tail import CsvTail, EdfTail


@contextmanager
def ecg_events(
    config: LiveConfig, folder: Path, tell: Callable[[str], None]
) -> Iterator[Callable[[], list[LiveEvent]]]:
    """What gives the ECG's events since its last call; none where the peers send it.

    Args:
        folder: where names of files begin.
        tell: is told what is wrong.
    Raises:
        MissingDependencyError: pylsl is absent.
    """
    ecg = config.ecg
    if isinstance(ecg, EcgFieldConfig):
        yield list
        return
    reader: EcgReader
    if isinstance(ecg, EcgStreamConfig):
        reader = LslEcg(ecg.lsl, ecg.rate_hz, ecg.channels, tell)
    else:
        path = folder / ecg.tail
        kind = EdfTail if path.suffix.lower() == ".edf" else CsvTail
        reader = kind(path, ecg.rate_hz, tell)
    with gathered(reader) as events:
        yield events
