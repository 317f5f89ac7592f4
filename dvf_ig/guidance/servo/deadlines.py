"""How late the ticks of a loop were."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, IntArray, InvalidInputError, read_only_arrays

BINS = 100_001
"""1 µs each, and one for all later than 0.1 s."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Deadlines:
    """Lateness of a loop's ticks.

    Attributes:
        counts: (BINS,) ticks by whole µs after their deadline.
        worst_us: the latest.
        skipped: deadlines that had passed before their tick could begin.
    """

    counts: IntArray
    worst_us: float
    skipped: int

    @property
    def ticks(self) -> int:
        return int(self.counts.sum())

    @property
    def run_share(self) -> float:
        """Share of the deadlines that had a tick."""
        return self.ticks / max(1, self.ticks + self.skipped)

    def percentile_us(self, percent: float) -> float:
        """Lateness that so many percent of the ticks did not exceed, to the upper end of its bin.

        Raises:
            InvalidInputError: no tick.
        """
        if self.ticks == 0:
            raise InvalidInputError("no tick ran, so there is no lateness; run the loop longer")
        at = int(np.searchsorted(np.cumsum(self.counts), 0.01 * percent * self.ticks))
        return self.worst_us if at >= BINS - 1 else min(self.worst_us, at + 1.0)


def deadlines_of(lateness_us: FloatArray, skipped: int) -> Deadlines:
    """Of ticks timed one by one."""
    bins = np.minimum(np.maximum(lateness_us, 0.0).astype(np.int64), BINS - 1)
    return Deadlines(np.bincount(bins, minlength=BINS), float(np.max(lateness_us, initial=0.0)), skipped)
