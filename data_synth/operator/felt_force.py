"""Reading of a fixture's force by an operator who has practised with it."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, read_only_arrays
from dvf_ig.core.arrays import frozen_floats


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class LearntForce:
    """Learnt distance to move along a felt force, by its size.

    Attributes:
        force_n: (n,) increasing, n >= 2.
        correction_mm: (n,) increasing: along the force to the intended position; negative: against it.
    """

    force_n: FloatArray
    correction_mm: FloatArray

    def __post_init__(self) -> None:
        force = frozen_floats(self.force_n, "learnt forces", (None,))
        correction = frozen_floats(self.correction_mm, "learnt corrections", (len(force),))
        if len(force) < 2 or (np.diff(force) <= 0.0).any() or (np.diff(correction) <= 0.0).any():
            raise InvalidInputError("a learnt force needs at least 2 increasing forces and corrections")
        object.__setattr__(self, "force_n", force)
        object.__setattr__(self, "correction_mm", correction)

    def read(self, force_n: float) -> tuple[float, float]:
        """Return the correction in mm and its slope in mm per N; constant beyond the ends."""
        i = int(np.clip(np.searchsorted(self.force_n, force_n) - 1, 0, len(self.force_n) - 2))
        low_n, high_n = self.force_n[i : i + 2].tolist()
        low_mm, high_mm = self.correction_mm[i : i + 2].tolist()
        slope = (high_mm - low_mm) / (high_n - low_n)
        at = min(max(force_n, low_n), high_n)
        return low_mm + slope * (at - low_n), slope
