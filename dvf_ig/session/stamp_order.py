"""Order of a stream's time stamps: repeated and reordered samples are dropped, a restarted clock refused."""

from collections import deque

JITTER_S = 0.1
"""A stamp may lie this far before the newest: samples overtook each other. Beyond it the clock restarted."""
WINDOW = 100
DEGRADED_SHARE = 0.1
"""More than this share of the last WINDOW samples dropped degrades (docs/theory/safety.md)."""


class StampOrder:
    """Watches the stamps of one stream, in the order in which its samples arrive."""

    def __init__(self) -> None:
        self.newest_s = float("-inf")
        self.restarted = False
        self._dropped: deque[bool] = deque(maxlen=WINDOW)

    def accepts(self, t_s: float) -> bool:
        """Whether a sample stamped `t_s` is later than all before it."""
        later = t_s > self.newest_s
        self._dropped.append(not later)
        if later:
            self.newest_s, self.restarted = t_s, False
        elif t_s < self.newest_s - JITTER_S:
            self.restarted = True
        return later

    @property
    def disordered(self) -> bool:
        """Whether too many of the recent samples came late or twice."""
        return sum(self._dropped) > DEGRADED_SHARE * WINDOW
