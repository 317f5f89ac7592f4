"""A rigid pose as six numbers of one size.

ξ = (rotation vector · radius, translation), all in mm at the heart's radius: a left perturbation of a pose
about the heart-box centre in the fixed frame.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import FloatArray, Rigid, read_only_arrays

HEART_RADIUS_MM = 40.0
"""Turns rad into mm, so that rotation and translation steps move the heart equally."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PoseChart:
    """Six coordinates about a pose; see the module docstring."""

    base: Rigid
    center_mm: FloatArray

    def pose(self, xi_mm: FloatArray) -> Rigid:
        return self.base.perturbed_left(xi_mm[:3] / HEART_RADIUS_MM, xi_mm[3:], self.center_mm)

    def coordinates(self, pose: Rigid) -> FloatArray:
        """(6,) ξ of a pose: the inverse of `pose`."""
        step = pose @ self.base.inverse()
        turn = HEART_RADIUS_MM * Rotation.from_matrix(step.rotation).as_rotvec()
        return np.concatenate([turn, step.apply_array(self.center_mm) - self.center_mm])


def distance_between(first: Rigid, second: Rigid, center_mm: FloatArray) -> float:
    """Mean distance in mm between two poses over six points at the heart's radius (fixed frame)."""
    corners = np.vstack([np.eye(3), -np.eye(3)]) * HEART_RADIUS_MM + center_mm
    source = first.inverse().apply_array(corners)
    return float(np.linalg.norm(second.apply_array(source) - corners, axis=1).mean())
