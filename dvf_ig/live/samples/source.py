"""Samples that no peer sends: a growing file or LSL streams, each read by its own thread.

The session's thread takes the available samples without waiting.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Protocol

from dvf_ig.intake.live import BreathStreamConfig, EcgStreamConfig, EcgTailConfig, LiveConfig
from dvf_ig.live.frames import LiveEvent
from dvf_ig.session import EcgSamples, RespirationSample

from .lsl import LslEcg
from .respiration import LslBreath
from .tail import EcgTail

MOST_BATCHES = 4096
EVERY_S = 0.01


class SampleReader(Protocol):
    """Reader that has new samples from time to time."""

    def read(self) -> Sequence[EcgSamples | RespirationSample]:
        """Return samples since the last call, stamped by this machine's monotonic clock; may wait."""


@contextmanager
def gathered(
    reader: SampleReader, clock: Callable[[], float] = time.monotonic
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

    thread = threading.Thread(target=gather, name="dvf-ig samples", daemon=True)
    thread.start()
    try:
        yield taken
    finally:
        stop.set()
        thread.join()


@contextmanager
def sampled_events(
    config: LiveConfig, folder: Path, tell: Callable[[str], None]
) -> Iterator[Callable[[], list[LiveEvent]]]:
    """Yield the function that returns new events of ECG and breathing; none of what the peers send.

    Args:
        folder: folder to which file names are relative.
        tell: called with messages about problems.
    Raises:
        MissingDependencyError: pylsl is absent.
    """
    ecg, breath = config.ecg, config.respiration
    readers: list[SampleReader] = []
    if isinstance(ecg, EcgStreamConfig):
        readers.append(LslEcg(ecg.lsl, ecg.rate_hz, ecg.lead, tell))
    elif isinstance(ecg, EcgTailConfig):
        readers.append(EcgTail(folder / ecg.tail, ecg.rate_hz, ecg.lead, tell))
    if isinstance(breath, BreathStreamConfig):
        readers.append(LslBreath(breath.lsl, breath.channel, tell))
    with ExitStack() as stack:
        sources = [stack.enter_context(gathered(reader)) for reader in readers]
        yield lambda: [event for source in sources for event in source()]
