"""Points touched on the beating heart's surface, and whether they can tell a pose at all."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, Points, read_only_arrays
from dvf_ig.core.arrays import frozen_floats

MIN_POINTS = 20
"""With 20 points a third of the poses of a real heart were 5 mm off (tuning seeds 101–106); with 40 none."""
MIN_SPREAD_MM = 8.0
"""Least standard deviation along the second of the points' principal axes: a patch some 30 mm wide."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TouchedPoints:
    """Points touched on the surface of the heart.

    Attributes:
        points: (n, 3) positions of the stylus tip, normally in "tracker".
        model_phase: (n,) place in the model's cycle at which each was touched; one number for all is their
            mean phase.
        sigma_mm: standard deviation of a point across the surface: stylus, phase, and difference of the
            patient from the model.
    """

    points: Points
    model_phase: FloatArray
    sigma_mm: float = 1.0

    def __post_init__(self) -> None:
        phase: Any = np.asarray(self.model_phase, dtype=np.float64)
        if phase.ndim == 0:
            phase = np.full(len(self.points), float(phase))
        object.__setattr__(
            self, "model_phase", frozen_floats(phase, "phases of touched points", (len(self.points),))
        )
        if not 0.05 <= self.sigma_mm <= 10.0:
            raise InvalidInputError(
                f"the standard deviation of touched points is {self.sigma_mm:g} mm; needed 0.05 to 10 mm"
            )

    def __len__(self) -> int:
        return len(self.points)


def require_spread(touched: TouchedPoints) -> None:
    """Refuse points that leave directions of a pose undetermined on any surface.

    Raises:
        InvalidInputError: fewer than MIN_POINTS, or all on one small patch or along one line.
    """
    if len(touched) < MIN_POINTS:
        raise InvalidInputError(
            f"{len(touched)} points were touched on the surface; needed at least {MIN_POINTS}, "
            "spread over all of the surface that can be reached"
        )
    xyz = touched.points.xyz_mm
    spread_mm = np.linalg.svd(xyz - xyz.mean(axis=0), compute_uv=False) / np.sqrt(len(xyz))
    if spread_mm[1] < MIN_SPREAD_MM:
        raise InvalidInputError(
            f"the touched points spread by {spread_mm[0]:.0f} mm and {spread_mm[1]:.0f} mm (standard "
            f"deviations along and across); needed {MIN_SPREAD_MM:.0f} mm both ways: touch more of the "
            "surface, on several sides of the heart"
        )
