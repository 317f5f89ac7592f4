"""Times in the cardiac cycle at which the phases of a 4-D data set were taken."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core.arrays import FloatArray, IntArray, frozen_floats, read_only_arrays
from dvf_ig.core.errors import InvalidInputError
from dvf_ig.core.plausible import CYCLE_SHARE, RR_S


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class CycleTiming:
    """Phase times of a cyclic series.

    Attributes:
        fractions: (n,) strictly increasing in [0, 1); 0 is the R peak. Spacing may be unequal.
        rr_s: RR interval at which the series was acquired.
        rr_assumed: True if `rr_s` was not recorded but assumed.
        timing_assumed: True if `fractions` are i/N because no times were recorded.
    """

    fractions: FloatArray
    rr_s: float
    rr_assumed: bool = False
    timing_assumed: bool = False

    def __post_init__(self) -> None:
        fractions = frozen_floats(self.fractions, "phase fractions", (None,))
        if len(fractions) < 2:
            raise InvalidInputError(f"a cycle has {len(fractions)} phases; needed at least 2")
        if fractions[0] < 0 or fractions[-1] >= 1 or (np.diff(fractions) <= 0).any():
            raise InvalidInputError(
                f"phase fractions run from {fractions[0]:g} to {fractions[-1]:g}; "
                "they must increase strictly within [0, 1)"
            )
        if not RR_S[0] <= self.rr_s <= RR_S[1]:
            raise InvalidInputError(f"RR interval is {self.rr_s:g} s; needed 0.2 to 3.0 s (is it in ms?)")
        object.__setattr__(self, "fractions", fractions)

    def __len__(self) -> int:
        return len(self.fractions)

    @classmethod
    def uniform(cls, phases: int, rr_s: float, *, rr_assumed: bool = False) -> "CycleTiming":
        """Build evenly spaced phases: phase i at i/N of the cycle."""
        return cls(np.arange(phases) / phases, rr_s, rr_assumed, timing_assumed=True)

    def bracket(self, phi: float) -> tuple[int, int, float]:
        """Find neighbouring phases of `phi` (cyclic) and the weight of the second: eq. 10's i, i+1, α."""
        phi = phi % 1.0
        count = len(self.fractions)
        after = int(np.searchsorted(self.fractions, phi, side="right"))
        first, second = (after - 1) % count, after % count
        width = (self.fractions[second] - self.fractions[first]) % 1.0
        return first, second, float(((phi - self.fractions[first]) % 1.0) / width)


def require_whole_cycle(fractions: FloatArray, what: str) -> None:
    """Refuse phases that span less than CYCLE_SHARE of the RR interval, as times in another unit do.

    Raises:
        InvalidInputError: states the share.
    """
    share = float(np.ptp(fractions)) * len(fractions) / max(len(fractions) - 1, 1)
    if share < CYCLE_SHARE:
        raise InvalidInputError(
            f"{what} spans {100 * share:.2g} % of the RR interval; needed at least {100 * CYCLE_SHARE:g} %: "
            "check its unit, or give --timing"
        )


def phase_distance(fractions: FloatArray, phases: FloatArray) -> FloatArray:
    """Compute (n, m) cyclic distances of (n,) phases from (m,) fractions, the shorter way round."""
    away = np.abs(np.asarray(phases)[:, None] - fractions[None, :])
    return np.asarray(np.minimum(away, 1 - away))


def nearest_phase(fractions: FloatArray, phases: FloatArray) -> IntArray:
    """Find (n,) the nearest of (m,) fractions of the cycle to each of (n,) phases."""
    return np.asarray(phase_distance(fractions, phases).argmin(axis=1), dtype=np.int64)


def phase_at_rest(fractions: FloatArray) -> int:
    """Find the fraction of the cycle nearest to the R peak, from which the heart contracts; its index."""
    return int(nearest_phase(fractions, np.zeros(1))[0])
