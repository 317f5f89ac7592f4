"""Boundary points and the model's surface as the kernels want them: sums of one Gauss–Newton step."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import HEART_RADIUS_MM, FloatArray, Rigid, require_same_frame
from dvf_ig.kernels.boundary import (
    RIGHT,
    SUMS,
    UNKNOWNS,
    DistanceSplines,
    OrientedPoints,
    boundary_step_sums,
)

from .points import BoundaryPoints
from .target import BoundaryTarget


@dataclass(frozen=True, slots=True, eq=False)
class Boundary:
    """Boundary points seen in the ultrasound, and the model's surface that they should lie on."""

    points: BoundaryPoints
    target: BoundaryTarget


class BoundaryProblem:
    """Points and target as the kernels want them."""

    def __init__(self, boundary: Boundary, center_mm: FloatArray) -> None:
        points, target = boundary.points, boundary.target
        self.source, self.target = points.frame, target.frame
        self.points = OrientedPoints(
            points.points_mm,
            points.normals,
            points.weights,
            target.nearest_phase(points.model_phase),
        )
        self.splines = DistanceSplines(target.coefficients, target.knots_from_mm, target.polarity)
        self.center_mm = np.array(center_mm, dtype=np.float64)
        self.total = float(points.weights.sum())

    def require_frames_of(self, start: Rigid) -> None:
        require_same_frame(self.source, start.source, "boundary registration")
        require_same_frame(self.target, start.target, "boundary registration")

    def sums(self, poses: FloatArray, offsets_mm: FloatArray, sigma_mm: float) -> FloatArray:
        """(m, SUMS) of `boundary_step_sums` at each of (m, 3, 4) poses."""
        out = np.empty((len(poses), SUMS))
        for pose, offset_mm, sums in zip(poses, offsets_mm.tolist(), out, strict=True):
            boundary_step_sums(
                self.points, self.splines, pose, self.center_mm, HEART_RADIUS_MM, offset_mm, sigma_mm, sums
            )
        return out


def normal_matrices(sums: FloatArray) -> FloatArray:
    """(m, 7, 7) JᵀωJ."""
    return sums[:, :RIGHT].reshape(-1, UNKNOWNS, UNKNOWNS)
