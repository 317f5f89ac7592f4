"""ECG that no peer sends: a growing file or an LSL stream, read by its own thread.

The session's thread takes the available samples without waiting.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from dvf_ig.intake.live import EcgFieldConfig, EcgStreamConfig, LiveConfig
from dvf_ig.live.timed import LiveEvent
from dvf_ig.session import EcgSamples

from .lsl import LslEcg
from .tail import EcgTail

MOST_BATCHES = 4096
EVERY_S = 0.01


class EcgReader(Protocol):
    """Reader that has new samples from time to time."""

    def read(self) -> list[EcgSamples]:
        """Return samples since the last call, stamped by this machine's monotonic clock; may wait."""
        ...


@contextmanager
def gathered(
    reader: EcgReader, clock: Callable[[], float] = time.monotonic
) -> Iterator[Callable[[], list[LiveEvent]]]:
    """Read in a thread; yield a function that returns new events or raises the thread's error."""
    waiting: deque[LiveEvent] = deque(maxlen=MOST_BATCHES)
    stop = threading.Event()
    failed: list[BaseException] = []

    def gather() -> None:
        try:
            while not stop.wait(EVERY_S):
                for samples in reader.read():
                    waiting.append(LiveEvent(clock(), samples))
        except BaseException as error:  # noqa: BLE001  raised again by the session's thread
            failed.append(error)

    def taken() -> list[LiveEvent]:
        if failed:
            raise failed[0]
        return [waiting.popleft() for _ in range(len(waiting))]

    thread = threading.Thread(target=gather, name="dvf-ig ecg", daemon=True)
    thread.start()
    try:
        yield taken
    finally:
        stop.set()
        thread.join()


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
        reader = LslEcg(ecg.lsl, ecg.rate_hz, ecg.lead, tell)
    else:
        reader = EcgTail(folder / ecg.tail, ecg.rate_hz, ecg.lead, tell)
    with gathered(reader) as events:
        yield events
