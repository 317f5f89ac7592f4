"""How single groups of boundary points pull the fitted pose."""

from dataclasses import replace

import numpy as np

from dvf_ig.core import FloatArray, IntArray
from dvf_ig.kernels.boundary import RIGHT, SHARE, UNKNOWNS

from .fit import Boundary, BoundaryFit, BoundaryFitOptions, BoundaryProblem, normal_matrix


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
    sigma, pose = opts.sigmas_mm[-1], fit.pose.matrix[:3]
    size = UNKNOWNS if opts.free_offset_mm > 0 else UNKNOWNS - 1
    whole = BoundaryProblem(boundary, center_mm).sums(pose, fit.offset_mm, sigma).copy()
    curvature = normal_matrix(whole)[:size, :size]
    right = np.stack(
        [
            BoundaryProblem(replace(boundary, points=boundary.points.subset(group == g)), center_mm)
            .sums(pose, fit.offset_mm, sigma)[RIGHT:SHARE][:size]
            .copy()
            for g in range(int(group.max()) + 1)
        ]
    )
    right = right - right.mean(axis=0)
    return np.asarray(-np.linalg.solve(curvature, right.T).T[:, :6])
