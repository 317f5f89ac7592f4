"""The clocks of peers on this machine's: a first offset by the message that came fastest.

A session's time is this machine's monotonic clock. A peer's stamps have an origin of their own; the largest
stamp less arrival of its first second is taken for the offset, so that the least latency counts as none. One
that is far from the median is wrong, not fast, and left out. What the peer's clock does afterwards, the
session watches (`dvf_ig.session.source_clock`).
"""

from dataclasses import dataclass, field
from statistics import median

SETTLE_S = 1.0
FASTEST_S = 0.25
"""No message of a link that is of use comes so much faster than half of them do."""
MOST_SEEN = 8192


@dataclass(slots=True)
class PeerClock:
    """The clock of one peer; stamps in the order in which they came."""

    _seen_s: list[float] = field(default_factory=list, init=False)
    """Stamps less arrivals, until the clock has settled."""
    _offset_s: float = field(default=0.0, init=False)
    _first_s: float | None = field(default=None, init=False)
    settled: bool = field(default=False, init=False)

    def see(self, stamp_s: float, arrived_s: float) -> None:
        """A stamp, and when it came; once the clock has settled, it changes nothing."""
        if self._first_s is None:
            self._first_s = arrived_s
        self.settled = self.settled or arrived_s - self._first_s >= SETTLE_S
        if not self.settled and len(self._seen_s) < MOST_SEEN:
            self._seen_s.append(stamp_s - arrived_s)
        elif self._seen_s:
            self._offset_s = self.offset_s
            self._seen_s = []

    @property
    def offset_s(self) -> float:
        """The peer's clock less this machine's; none of a peer that stamps nothing."""
        if not self._seen_s:
            return self._offset_s
        usual_s = median(self._seen_s)
        return max(seen_s for seen_s in self._seen_s if seen_s <= usual_s + FASTEST_S)

    def local_s(self, stamp_s: float | None, arrived_s: float) -> float:
        """A stamp by this machine's clock; the arrival where the sender gave none."""
        return arrived_s if stamp_s is None else stamp_s - self.offset_s
