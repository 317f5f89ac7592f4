"""The boundary's cost block by block of space: how each group of points pulls, to second order."""

from dataclasses import dataclass, replace

import numpy as np

from dvf_ig.core import FloatArray, IntArray, Rigid, read_only_arrays
from dvf_ig.kernels.boundary import RIGHT, SQUARES, UNKNOWNS

from .fit import BoundaryFit
from .options import BoundaryFitOptions
from .problem import Boundary, BoundaryProblem, normal_matrices


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BoundaryBlocks:
    """−log likelihood of the points of each block, one observation a point, to second order at a pose.

    Attributes:
        cell: (n, 3) which block of space, in steps of its edge in the points' frame.
        gradient: (n, 7); curvature: (n, 7, 7) over the coordinates of `PoseChart` and the offset.
    """

    cell: IntArray
    gradient: FloatArray
    curvature: FloatArray


def boundary_blocks(
    boundary: Boundary, fit: BoundaryFit, pose: Rigid, center_mm: FloatArray, *, block_mm: float
) -> BoundaryBlocks:
    """Every block at a pose, with the offset of a fit.

    Args:
        block_mm: edge of a block of space.
    """
    points, sigma_mm = boundary.points, BoundaryFitOptions().sigmas_mm[-1]
    at, offset = pose.matrix[None, :3], np.array([fit.offset_mm])
    cell, group = np.unique(
        np.floor(points.points_mm / block_mm).astype(np.int64), axis=0, return_inverse=True
    )
    parts = [points.subset(group.ravel() == k) for k in range(len(cell))]
    sums = np.vstack(
        [
            BoundaryProblem(replace(boundary, points=part), center_mm).sums(at, offset, sigma_mm)
            for part in parts
        ]
    )
    curvature = normal_matrices(sums)
    variance = float(sums[:, SQUARES].sum()) / max(float(curvature[:, 6, 6].sum()), 1e-12)
    scale = 1.0 / max(variance, 1e-12)
    return BoundaryBlocks(cell, scale * sums[:, RIGHT : RIGHT + UNKNOWNS], scale * curvature)
