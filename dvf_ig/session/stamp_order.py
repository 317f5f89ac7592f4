"""Order of a stream's time stamps: repeated and reordered samples are dropped, a restarted clock refused."""

from collections import deque
from typing import NamedTuple

JITTER_S = 0.1
"""A stamp may lie this far before the newest: samples overtook each other. Beyond it the clock restarted."""
WINDOW = 100
DEGRADED_SHARE = 0.1
"""More than this share of the last WINDOW samples dropped degrades (docs/theory/safety.md)."""


class StampOrder:
    """Watches the stamps of one stream, in the order in which its samples arrive.

    A stream may be handed over ahead of time: what is wrong with a sample counts from the newest stamp that
    came before it.
    """

    def __init__(self) -> None:
        self.newest_s = float("-inf")
        self.restarted = False
        """Whether the clock has gone back and no later sample has come since."""
        self._waiting: deque[_Arrival] = deque()
        self._dropped: deque[bool] = deque(maxlen=WINDOW)
        self._dropped_in_a_row = 0

    def accepts(self, t_s: float, last_s: float | None = None) -> bool:
        """Whether a sample stamped `t_s` is later than all before it.

        Args:
            last_s: stamp of the last of several samples that came together; None of a single one.
        """
        later, back = t_s > self.newest_s, t_s < self.newest_s - JITTER_S
        if later:
            self.newest_s = t_s if last_s is None else last_s
        self._dropped_in_a_row = 0 if later else self._dropped_in_a_row + 1
        if self._dropped_in_a_row <= WINDOW:
            self._waiting.append(_Arrival(self.newest_s, later, back))
        return later

    def advance(self, now_s: float) -> None:
        """What arrived behind stamps until now counts; times in order."""
        while self._waiting and self._waiting[0].from_s <= now_s:
            arrival = self._waiting.popleft()
            self._dropped.append(not arrival.later)
            self.restarted = arrival.back or (self.restarted and not arrival.later)

    @property
    def disordered(self) -> bool:
        """Whether too many of the recent samples came late or twice."""
        return sum(self._dropped) > DEGRADED_SHARE * WINDOW


class _Arrival(NamedTuple):
    """A sample that arrived: from when it counts, and how its stamp compares with those before."""

    from_s: float
    later: bool
    back: bool
