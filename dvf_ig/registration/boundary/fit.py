"""Register boundary points to the model's signed distance: robust Gauss–Newton, some milliseconds a start.

The scale σ of Geman–McClure is annealed from 12 to 2 mm: a far start is first pulled by everything, at last
only by what lies on the surface. Ultrasound blooms walls into the blood by up to a millimetre, alike
everywhere: a uniform offset along the normal is a seventh unknown once σ <= 4 mm
(docs/theory/registration.md).
Rank the ends of many starts by image similarity, not by `score`: the boundary alone prefers wrong optima at
times.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Rigid, read_only_arrays
from dvf_ig.kernels.boundary import SHARE, SQUARES, UNKNOWNS, boundary_residuals
from dvf_ig.registration.pose_chart import covariance_from_mm

from .descent import NEAR_MM, POINTS_PER_OBSERVATION, DescentEnds, descend, pose_of
from .options import BoundaryFitOptions
from .problem import Boundary, BoundaryProblem, normal_matrices


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BoundaryFit:
    """A pose fitted to boundary points, with its residual and covariance.

    Attributes:
        pose: target_from_source.
        offset_mm: distance of the points from the surface, positive inside, common to all.
        share_near: share of the weight within NEAR_MM of the surface with normals in agreement.
        residual_mm: RMS of d − offset over those.
        covariance: (6, 6) rad², mm²; rotation first, left perturbation about the centre; NaN if singular.
        score: share of the weight that lies on the surface, soft at the last scale.
        converged: whether the last step was shorter than the tolerance and some points are near.
        evaluations: effort.
    """

    pose: Rigid
    offset_mm: float
    share_near: float
    residual_mm: float
    covariance: FloatArray
    score: float
    converged: bool
    evaluations: int


def fit_boundary(
    boundary: Boundary,
    start: Rigid,
    center_mm: FloatArray,
    *,
    options: BoundaryFitOptions | None = None,
) -> BoundaryFit:
    """Register boundary points to the surface from one start.

    Args:
        boundary: points in the frame of `start.source`, surface in that of `start.target`.
        center_mm: (3,) centre of the heart box in the target frame, about which the pose turns.
    Raises:
        FrameMismatchError: frames do not meet.
    """
    opts = options or BoundaryFitOptions()
    problem = BoundaryProblem(boundary, center_mm)
    return fit_at_end(problem, start, descend(problem, [start], opts), 0, opts)


def fit_at_end(
    problem: BoundaryProblem, start: Rigid, ends: DescentEnds, k: int, opts: BoundaryFitOptions
) -> BoundaryFit:
    """The fit that the k-th descent ended with."""
    pose, offset_mm = ends.poses[k].copy(), float(ends.offsets_mm[k])
    sums = problem.sums(pose[None], np.array([offset_mm]), opts.sigmas_mm[-1])[0]
    distance, agreement = np.empty((2, len(problem.points.points)))
    boundary_residuals(problem.points, problem.splines, pose, distance, agreement)
    apart = distance - offset_mm
    near = (np.abs(apart) < NEAR_MM) & (agreement > 0)
    weight = problem.points.weights
    residual = float(np.sqrt(np.mean(apart[near] ** 2))) if near.any() else float("nan")
    return BoundaryFit(
        pose=pose_of(start, pose),
        offset_mm=offset_mm,
        share_near=float(weight[near].sum()) / problem.total,
        residual_mm=residual,
        covariance=_covariance(sums, opts),
        score=float(sums[SHARE]) / problem.total,
        converged=bool(ends.converged[k] and near.any()),
        evaluations=int(ends.evaluations[k]),
    )


def _covariance(sums: FloatArray, opts: BoundaryFitOptions) -> FloatArray:
    """Of the pose with the offset unknown: inverse curvature times the variance of one observation."""
    matrix = normal_matrices(sums[None])[0]
    size = UNKNOWNS if opts.free_offset_mm > 0 else UNKNOWNS - 1
    curvature = matrix[:size, :size]
    weight = float(matrix[6, 6])
    if not weight > 0 or np.linalg.cond(curvature) > 1e10:
        return np.full((6, 6), np.nan)
    variance = POINTS_PER_OBSERVATION * float(sums[SQUARES]) / weight
    return covariance_from_mm(np.asarray((variance * np.linalg.inv(curvature))[:6, :6], dtype=np.float64))
