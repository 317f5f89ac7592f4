"""How single groups of boundary points pull the fitted pose."""

from dataclasses import replace

import numpy as np

from dvf_ig.core import FloatArray, IntArray
from dvf_ig.kernels.boundary import RIGHT, UNKNOWNS

from .fit import Boundary, BoundaryFit, BoundaryFitOptions, BoundaryProblem, normal_matrices


def boundary_influence(
    boundary: Boundary,
    fit: BoundaryFit,
    center_mm: FloatArray,
    group: IntArray,
    options: BoundaryFitOptions | None = None,
) -> FloatArray:
    """(groups, 6) first-order influence of each group of points on the fitted pose; see `evidence.sandwich`.

    Args:
        group: (n,) number of each point's group, 0 to groups − 1.
    """
    opts = options or BoundaryFitOptions()
    size = UNKNOWNS if opts.free_offset_mm > 0 else UNKNOWNS - 1
    pose, offset = fit.pose.matrix[None, :3], np.array([fit.offset_mm])

    def sums_of(part: Boundary) -> FloatArray:
        return BoundaryProblem(part, center_mm).sums(pose, offset, opts.sigmas_mm[-1])

    curvature = normal_matrices(sums_of(boundary))[0, :size, :size]
    parts = [boundary.points.subset(group == g) for g in range(int(group.max()) + 1)]
    right = np.vstack([sums_of(replace(boundary, points=part))[:, RIGHT : RIGHT + size] for part in parts])
    right = right - right.mean(axis=0)
    return np.asarray(-np.linalg.solve(curvature, right.T).T[:, :6])
