"""Whether a registered pose puts touched points on the model's surface."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import DvfModel, FloatArray, Rigid, read_only_arrays

from .distance import SurfaceDistance
from .touched import TouchedPoints

ALLOWED_MM = 2.0
"""Error of a registration that is good enough; a third of its square shows across a surface."""
OUTLIER_SHARE = 0.2
"""Points may be so often off the surface."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SurfaceDisagreement:
    """How far touched points lie from the model's surface at a pose.

    Attributes:
        median_mm: median of |d|.
        limit_mm: most that noise of the points, outliers among them and a good registration explain.
        distance_mm: (n,) signed distance of each point, positive inside.
    """

    median_mm: float
    limit_mm: float
    distance_mm: FloatArray

    @property
    def agrees(self) -> bool:
        return self.median_mm <= self.limit_mm

    @property
    def sentence(self) -> str:
        """The check, as a user reads it."""
        found = (
            f"touched points lie {self.median_mm:.1f} mm from the surface (median of {len(self.distance_mm)}"
        )
        if self.agrees:
            return f"{found}; up to {self.limit_mm:.1f} mm agrees with the pose)"
        return f"{found}; needed at most {self.limit_mm:.1f} mm): the pose or the touched points are wrong"


def surface_disagreement(pose: Rigid, touched: TouchedPoints, model: DvfModel) -> SurfaceDisagreement:
    """Check a registered pose against points touched on the surface.

    The median of |d| of n points of normal spread s is (0.89 ± 0.79/√n) s with OUTLIER_SHARE of outliers;
    s² = σ² + ALLOWED_MM²/3, and three standard deviations are allowed. A pose that slides the surface on
    itself stays unseen.

    Raises:
        FrameMismatchError: the pose does not map the points into the model's frame.
    """
    distance = SurfaceDistance(touched, model, np.zeros(3)).residuals_mm(pose)
    spread = float(np.hypot(touched.sigma_mm, ALLOWED_MM / np.sqrt(3)))
    limit = spread * (0.89 + 3 * 0.79 / np.sqrt(len(touched)))
    return SurfaceDisagreement(float(np.median(np.abs(distance))), float(limit), distance)
