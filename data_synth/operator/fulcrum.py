"""Instrument through a fixed point of the body wall: positions of and forces on tip and hand."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, read_only_arrays
from dvf_ig.core.arrays import frozen_floats


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Fulcrum:
    """Trocar that lets an instrument only slide and turn.

    tip = P − (L − r)u and hand = P + r·u with u the unit vector from P to the hand: sideways motion of the
    hand is inverted and scaled by (L − r)/r, motion along the instrument is not.

    Attributes:
        point_mm: (3,) P.
        length_mm: L, from the hand to the tip.
    """

    point_mm: FloatArray
    length_mm: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_mm", frozen_floats(self.point_mm, "fulcrum", (3,)))
        if not 0.0 < self.length_mm < np.inf:
            raise InvalidInputError(f"the instrument is {self.length_mm:g} mm long; needed a positive length")

    def tip(self, hand_mm: FloatArray) -> FloatArray:
        """Compute the tip (3,) for a hand (3,)."""
        out = hand_mm - self.point_mm
        r = float(np.linalg.norm(out))
        return np.asarray(self.point_mm - (self.length_mm / r - 1.0) * out)

    def hand(self, tip_mm: FloatArray) -> FloatArray:
        """Compute the hand (3,) for a tip (3,)."""
        out = self.point_mm - tip_mm
        inside = float(np.linalg.norm(out))
        return np.asarray(self.point_mm + (self.length_mm / inside - 1.0) * out)

    def lever(self, tip_mm: FloatArray) -> float:
        """Compute (L − r)/r, the tip's sideways speed over the hand's."""
        inside = float(np.linalg.norm(tip_mm - self.point_mm))
        return inside / (self.length_mm - inside)
