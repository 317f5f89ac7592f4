"""ECG gathered by its own thread; the session's thread takes the available samples without waiting."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from dvf_ig.live.timed import LiveEvent
from dvf_ig.session import EcgSamples

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
