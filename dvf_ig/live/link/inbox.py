"""Queue of arrived messages not yet processed: bounded, refusing the newest when full."""

import threading
from collections import deque
from typing import NamedTuple

from dvf_ig.live.igtl import Image, Message
from dvf_ig.live.igtl.incoming import Taken

MOST = 4096
"""Largest number of messages and bytes: ten seconds of a tracker at 100 Hz with three tools, or forty of two
minutes' images."""
MOST_BYTES = 128 << 20


class Arrival(NamedTuple):
    """Message, or why it was refused, with the time of its last byte and its sender."""

    arrived_s: float
    peer: str
    taken: Taken


class Inbox:
    """Queue that receiving threads fill and the session's thread empties."""

    def __init__(self) -> None:
        self._waiting: deque[Arrival] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self.dropped = 0
        """Number of arrivals refused because the queue was full."""

    def put(self, arrival: Arrival) -> None:
        """Add an arrival without waiting."""
        size = _bytes_of(arrival)
        with self._changed:
            if len(self._waiting) >= MOST or self._bytes + size > MOST_BYTES:
                self.dropped += 1
                return
            self._waiting.append(arrival)
            self._bytes += size
            self._changed.notify()

    def take(self, wait_s: float, most: int = MOST) -> list[Arrival]:
        """Remove up to `most` arrivals, waiting at most `wait_s` for the first."""
        with self._changed:
            if not self._waiting:
                self._changed.wait(wait_s)
            arrivals = [self._waiting.popleft() for _ in range(min(most, len(self._waiting)))]
            self._bytes -= sum(map(_bytes_of, arrivals))
        return arrivals


def _bytes_of(arrival: Arrival) -> int:
    message = arrival.taken
    if isinstance(message, Message) and isinstance(message.content, Image):
        return int(message.content.pixels.nbytes)
    return 256
