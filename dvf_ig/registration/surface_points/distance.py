"""Signed distance of moved points to the model's surface, each at its own phase, with its Jacobian.

The distance of two neighbouring phases is blended linearly, as the fixture does. Outside of the spline's box
the distance is that at the nearest place of the box less the way to it.
"""

import numpy as np

from dvf_ig.core import HEART_RADIUS_MM, DvfModel, FloatArray, Rigid, require_same_frame
from dvf_ig.kernels import status as code
from dvf_ig.kernels.dynamic import force_batch
from dvf_ig.kernels.fixture_field import BLEND_DISTANCE, packed_fixture

from .touched import TouchedPoints


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
            np.eye(3, 4),
        )
        self._force, self._gradient = np.empty((2, n, 3))
        self._distance, self._rate = np.empty((2, n))
        self._status = np.empty(n, dtype=np.int64)

    def residuals_mm(self, pose: Rigid) -> FloatArray:
        """(n,) distance d(T p), positive inside the heart."""
        return self._at(self._moved(pose))[0]

    def linearised(self, pose: Rigid) -> tuple[FloatArray, FloatArray]:
        """(n,) residuals and (n, 6) their derivatives in the coordinates of `PoseChart` about `pose`."""
        xyz = self._moved(pose)
        distance, gradient = self._at(xyz)
        turning = np.cross(xyz - self.center_mm, gradient) / HEART_RADIUS_MM
        return distance, np.hstack([turning, gradient])

    def _moved(self, pose: Rigid) -> FloatArray:
        require_same_frame(pose.target, self.frame, "pose of touched points")
        return pose.apply(self.points).xyz_mm

    def _at(self, xyz_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance and gradient, (n,) and (n, 3)."""
        within = np.ascontiguousarray(np.clip(xyz_mm, self._lower, self._upper))
        self._status[:] = code.OK
        force_batch(
            self._coefficients,
            self._packed,
            within,
            self._phase,
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
