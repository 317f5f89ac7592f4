"""What has arrived and was not yet looked at: bounded, the newest refused where it is full."""

import threading
from collections import deque
from typing import NamedTuple

from dvf_ig.live.igtl import Image, Message
from dvf_ig.live.igtl.incoming import Taken

MOST = 4096
"""Messages: ten seconds of a tracker at 100 Hz with three tools, or forty of two minutes' images."""
MOST_BYTES = 128 << 20


class Arrival(NamedTuple):
    """A message, or why it was refused; when its last byte came, and from whom."""

    arrived_s: float
    peer: str
    taken: Taken


class Inbox:
    """Filled by the threads that receive, emptied by the one that runs the session."""

    def __init__(self) -> None:
        self._waiting: deque[Arrival] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self.dropped = 0
        """Arrivals for which there was no room."""

    def put(self, arrival: Arrival) -> None:
        """Add one; never waits."""
        size = _bytes_of(arrival)
        with self._changed:
            if len(self._waiting) >= MOST or self._bytes + size > MOST_BYTES:
                self.dropped += 1
                return
            self._waiting.append(arrival)
            self._bytes += size
            self._changed.notify()

    def take(self, wait_s: float, most: int = MOST) -> list[Arrival]:
        """The first `most` that are there, after waiting for one no longer than `wait_s`."""
        with self._changed:
            if not self._waiting:
                self._changed.wait(wait_s)
            taken = [self._waiting.popleft() for _ in range(min(most, len(self._waiting)))]
            self._bytes -= sum(map(_bytes_of, taken))
        return taken


def _bytes_of(arrival: Arrival) -> int:
    taken = arrival.taken
    if isinstance(taken, Message) and isinstance(taken.content, Image):
        return int(taken.content.pixels.nbytes)
    return 256
