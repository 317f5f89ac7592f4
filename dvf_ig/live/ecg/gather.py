"""An ECG that a thread of its own gathers; the session's thread takes what is there and never waits."""

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
    """Something that has new samples now and then."""

    def read(self) -> list[EcgSamples]:
        """Those since the last call, stamped by this machine's monotonic clock; may wait a while."""
        ...


@contextmanager
def gathered(
    reader: EcgReader, clock: Callable[[], float] = time.monotonic
) -> Iterator[Callable[[], list[LiveEvent]]]:
    """Read in a thread; yields what gives the events since its last call, or raises what ended the thread."""
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
