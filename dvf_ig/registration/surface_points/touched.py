"""Points touched on the beating heart, their distance from the model's surface, and the check of a pose.

The distance of two neighbouring phases is blended linearly, as the fixture does. Outside of the spline's box
the distance is that at the nearest position of the box less the way to it.
"""

import math
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import (
    HEART_RADIUS_MM,
    DvfModel,
    FloatArray,
    InvalidInputError,
    Rigid,
    TouchedPoints,
    Warp,
    read_only_arrays,
    require_same_frame,
)
from dvf_ig.kernels import status as code
from dvf_ig.kernels.dynamic import force_batch
from dvf_ig.kernels.fixture_field import BLEND_DISTANCE, packed_fixture

MIN_POINTS = 20
"""With 20 points a third of the poses of a real heart were 5 mm off (tuning seeds 101–106); with 40 none."""
MIN_SPREAD_MM = 8.0
"""Least standard deviation along the second of the points' principal axes: a patch some 30 mm wide."""
ALLOWED_MM = 2.0
"""Error of a registration that is good enough; a third of its square shows across a surface."""
OUTLIER_SHARE = 0.2
"""Share of the points that may be off the surface."""


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


class SurfaceDistance:
    """Residual d(T p) of touched points, ready to evaluate at many poses; serves one thread.

    Args:
        touched: points.
        model: fixture model.
        center_mm: (3,) about which poses turn, the model's frame.
    """

    def __init__(self, touched: TouchedPoints, model: DvfModel, center_mm: FloatArray) -> None:
        n = len(touched)
        self.frame = model.frame
        self.points = touched.points
        self.center_mm = np.array(center_mm, dtype=np.float64)
        self._phase = touched.model_phase.copy()
        self._at_rest = np.full(n, model.timing.fractions[model.rest_phase])
        self._coefficients = model.coefficients.copy()
        self._lower, self._upper = model.origin_mm, model.upper_mm
        no_force = np.zeros(5)
        self._packed = packed_fixture(
            model.origin_mm,
            model.knot_spacing_mm,
            model.timing.fractions,
            np.zeros((0, 4, 4)),
            no_force,
            BLEND_DISTANCE,
            None,
            np.eye(3, 4),
        )
        self._force, self._gradient = np.empty((2, n, 3))
        self._distance, self._rate = np.empty((2, n))
        self._status = np.empty(n, dtype=np.int64)

    def residuals_mm(self, pose: Rigid, warp: Warp | None = None) -> FloatArray:
        """(n,) distance d(T p), positive inside the heart; of a heart that changed its shape by a warp."""
        places = self._moved(pose)
        if warp is None:
            return self._at(places, self._phase)[0]
        places = warp.model_places(places)
        at_rest = self._at(places, self._at_rest)[0]
        return at_rest + warp.contraction * (self._at(places, self._phase)[0] - at_rest)

    def linearised(self, pose: Rigid) -> tuple[FloatArray, FloatArray]:
        """(n,) residuals and (n, 6) their derivatives in the coordinates of `PoseChart` about `pose`."""
        xyz = self._moved(pose)
        distance, gradient = self._at(xyz, self._phase)
        turning = np.cross(xyz - self.center_mm, gradient) / HEART_RADIUS_MM
        return distance, np.hstack([turning, gradient])

    def _moved(self, pose: Rigid) -> FloatArray:
        require_same_frame(pose.target, self.frame, "pose of touched points")
        return pose.apply(self.points).xyz_mm

    def _at(self, xyz_mm: FloatArray, phase: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance and gradient, (n,) and (n, 3), each at its own phase of the model."""
        within = np.ascontiguousarray(np.clip(xyz_mm, self._lower, self._upper))
        self._status[:] = code.OK
        force_batch(
            self._coefficients,
            self._packed,
            within,
            phase,
            self._force,
            self._distance,
            self._gradient,
            self._rate,
            self._status,
        )
        beyond = xyz_mm - within
        way = np.linalg.norm(beyond, axis=1)
        gradient = np.where(beyond != 0.0, 0.0, self._gradient)
        gradient -= beyond / np.maximum(way, 1e-12)[:, None]
        return self._distance - way, gradient


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
        measured = (
            f"touched points lie {self.median_mm:.1f} mm from the surface (median of {len(self.distance_mm)}"
        )
        if self.agrees:
            return f"{measured}; up to {self.limit_mm:.1f} mm agrees with the pose)"
        return f"{measured}; needed at most {self.limit_mm:.1f} mm): the pose or the touched points are wrong"


@dataclass(frozen=True, slots=True, eq=False)
class TouchedSurface:
    """Points touched on the heart, and the model whose surface they should lie on."""

    points: TouchedPoints
    model: DvfModel

    def disagreement(self, pose: Rigid, warp: Warp | None = None) -> SurfaceDisagreement:
        """Check a registered pose.

        The median of |d| of n points of normal spread s is (0.89 ± 0.79/√n) s with OUTLIER_SHARE of outliers;
        s² = σ² + ALLOWED_MM²/3, with the mean variance of a change of shape, and three standard deviations
        are allowed. A pose that slides the surface on itself stays unseen.

        Args:
            warp: change of shape that fixtures follow; None: the heart is as in the model.
        Raises:
            FrameMismatchError: the pose does not map the points into the model's frame.
        """
        distance = SurfaceDistance(self.points, self.model, np.zeros(3)).residuals_mm(pose, warp)
        of_shape = 0.0 if warp is None else float(warp.at(pose.apply(self.points.points).xyz_mm)[1].mean())
        spread = math.sqrt(self.points.sigma_mm**2 + ALLOWED_MM**2 / 3.0 + of_shape)
        limit = spread * (0.89 + 3 * 0.79 / np.sqrt(len(self.points)))
        return SurfaceDisagreement(float(np.median(np.abs(distance))), float(limit), distance)
