"""The clocks of peers on this machine's: a first offset by the message that came fastest.

A session's time is this machine's monotonic clock. A peer's stamps have an origin of their own; the largest
stamp less arrival of its first second is taken for the offset, so that the least latency counts as none. What
the peer's clock does afterwards, the session watches (`dvf_ig.session.source_clock`).
"""

from dataclasses import dataclass, field
from math import inf

SETTLE_S = 1.0


@dataclass(slots=True)
class PeerClock:
    """The clock of one peer; stamps in the order in which they came."""

    _largest_s: float = field(default=-inf, init=False)
    _first_s: float | None = field(default=None, init=False)
    settled: bool = field(default=False, init=False)

    def see(self, stamp_s: float, arrived_s: float) -> None:
        """A stamp, and when it came; once the clock has settled, it changes nothing."""
        if self._first_s is None:
            self._first_s = arrived_s
        self.settled = self.settled or arrived_s - self._first_s >= SETTLE_S
        if not self.settled:
            self._largest_s = max(self._largest_s, stamp_s - arrived_s)

    @property
    def offset_s(self) -> float:
        """The peer's clock less this machine's; none of a peer that stamps nothing."""
        return self._largest_s if self._largest_s > -inf else 0.0

    def local_s(self, stamp_s: float | None, arrived_s: float) -> float:
        """A stamp by this machine's clock; the arrival where the sender gave none."""
        return arrived_s if stamp_s is None else stamp_s - self.offset_s
