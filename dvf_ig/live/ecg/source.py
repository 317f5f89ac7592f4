"""ECG source named in the configuration, if no peer sends the ECG."""

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
    """Yield the function that returns the ECG's new events; it returns none if the peers send it.

    Args:
        folder: folder to which file names are relative.
        tell: called with messages about problems.
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
