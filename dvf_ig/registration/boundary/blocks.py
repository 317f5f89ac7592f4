"""The boundary's cost block by block of space: how each group of points pulls, to second order."""

import numpy as np

from dvf_ig.core import HEART_RADIUS_MM, FloatArray, IntArray, Rigid
from dvf_ig.kernels.boundary import RIGHT, SQUARES, SUMS, UNKNOWNS, OrientedPoints, boundary_step_sums
from dvf_ig.registration.distinct_rows import distinct_rows

from .options import BoundaryFitOptions
from .problem import Boundary, BoundaryProblem, normal_matrices


class BlockedBoundary:
    """The boundary's points of every block of space.

    Attributes:
        cell: (n, 3) which block of space, in steps of its edge in the points' frame.
        offset_mm: of the surface, from which that of a state is counted.
    """

    def __init__(
        self, boundary: Boundary, offset_mm: float, center_mm: FloatArray, *, block_mm: float
    ) -> None:
        """Sort the points by their blocks.

        Args:
            offset_mm: of the boundary's fit.
            block_mm: edge of a block.
        """
        cells = np.floor(boundary.points.points_mm / block_mm).astype(np.int64)
        self.cell, group = distinct_rows(cells)
        order = np.argsort(group, kind="stable")
        sorted_points = Boundary(boundary.points.subset(order), boundary.target)
        self._problem = BoundaryProblem(sorted_points, center_mm)
        self._group: IntArray = group[order]
        self._ends = np.concatenate([[0], np.cumsum(np.bincount(group))]).tolist()
        self.offset_mm = offset_mm

    def expansion(self, pose: Rigid, shift_mm: FloatArray, offset_mm: float) -> tuple[FloatArray, FloatArray]:
        """(n, 7) gradient and (n, 7, 7) curvature of −log likelihood, one observation a point, at a pose.

        Args:
            shift_mm: (n, 3) by which each block is moved beside the pose, target frame.
            offset_mm: of the surface, added to that of the fit.
        """
        problem = self._problem
        points = problem.points
        moved = points.points + (shift_mm @ pose.rotation)[self._group]
        sums = np.empty((len(self.cell), SUMS))
        for out, begin, end in zip(sums, self._ends, self._ends[1:], strict=False):
            part = OrientedPoints(
                moved[begin:end],
                points.normals[begin:end],
                points.weights[begin:end],
                points.phases[begin:end],
            )
            boundary_step_sums(
                part,
                problem.splines,
                pose.matrix[:3],
                problem.center_mm,
                HEART_RADIUS_MM,
                self.offset_mm + offset_mm,
                BoundaryFitOptions().sigmas_mm[-1],
                out,
            )
        curvature = normal_matrices(sums)
        variance = float(sums[:, SQUARES].sum()) / max(float(curvature[:, 6, 6].sum()), 1e-12)
        scale = 1.0 / max(variance, 1e-12)
        return scale * sums[:, RIGHT : RIGHT + UNKNOWNS], scale * curvature
