"""Register boundary points to the model's signed distance: robust Gauss–Newton, some milliseconds a start.

The scale σ of Geman–McClure is annealed from 12 to 2 mm: a far start is first pulled by everything, at last
only by what lies on the surface. Ultrasound blooms walls into the blood by up to a millimetre, alike
everywhere: a uniform offset along the normal is a seventh unknown once σ <= 4 mm
(docs/theory/registration.md).
Rank the ends of many starts by image similarity, not by `score`: the boundary alone prefers wrong optima at
times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import HEART_RADIUS_MM, FloatArray, Rigid, read_only_arrays, require_same_frame
from dvf_ig.core.rigid import nearest_rotation
from dvf_ig.kernels.boundary import (
    RIGHT,
    SHARE,
    SQUARES,
    SUMS,
    UNKNOWNS,
    DistanceSplines,
    OrientedPoints,
    boundary_residuals,
    boundary_step_sums,
)
from dvf_ig.registration.pose_chart import (
    PoseChart,
    covariance_from_mm,
    distinct,
    random_displacements,
)

from .points import BoundaryPoints
from .target import BoundaryTarget

NEAR_MM = 2.0
POINTS_PER_OBSERVATION = 30.0
"""Neighbouring points share their difference from the model: with this divisor the standard deviations match
the errors of fits on tuning seeds 101–103."""


@dataclass(frozen=True, slots=True)
class BoundaryFitOptions:
    """Scales, steps and the offset's prior of a boundary fit.

    Attributes:
        sigmas_mm: scales, from far to near.
        steps: at each scale but the last.
        last_steps: most at the last scale.
        free_offset_mm: the offset is free at scales up to this; 0 fixes it at the expected one.
        expected_offset_mm, offset_sigma_mm: mean and standard deviation of the offset before the fit.
        cap_mm: longest step.
        tolerance_mm: a step shorter than this ends the last scale; ten times as long a one ends the others.
    """

    sigmas_mm: tuple[float, ...] = (12.0, 8.0, 5.5, 4.0, 2.8, 2.0)
    steps: int = 8
    last_steps: int = 12
    free_offset_mm: float = 4.0
    expected_offset_mm: float = 0.0
    offset_sigma_mm: float = 1.0
    cap_mm: float = 8.0
    tolerance_mm: float = 0.02


EPICARDIUM_FIT = BoundaryFitOptions(free_offset_mm=12.0, expected_offset_mm=-4.0, offset_sigma_mm=3.0)
"""For the surface of a fixture model. Ultrasound shows the pericardium there, which lies outside of the
epicardium by the fat between them (5.5 mm on tuning seeds 101–103): the offset is free from the start."""
QUICK_POINTS = 800
"""Of the first fits from many starts."""


@dataclass(frozen=True, slots=True, eq=False)
class Boundary:
    """Boundary points seen in the ultrasound, and the model's surface that they should lie on."""

    points: BoundaryPoints
    target: BoundaryTarget


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


class BoundaryProblem:
    """Points and target as the kernels want them, with one buffer; serves one thread."""

    def __init__(self, boundary: Boundary, center_mm: FloatArray) -> None:
        points, target = boundary.points, boundary.target
        self.points = OrientedPoints(
            points.points_mm,
            points.normals,
            points.weights,
            target.nearest_phase(points.model_phase),
        )
        self.splines = DistanceSplines(target.coefficients, target.knots_from_mm, target.polarity)
        self.center_mm = np.array(center_mm, dtype=np.float64)
        self.total = float(points.weights.sum())
        self.out = np.empty(SUMS)

    def sums(self, pose: FloatArray, offset_mm: float, sigma_mm: float) -> FloatArray:
        """(SUMS,) of `boundary_step_sums` at a (3, 4) pose: the buffer."""
        boundary_step_sums(
            self.points,
            self.splines,
            pose,
            self.center_mm,
            HEART_RADIUS_MM,
            offset_mm,
            sigma_mm,
            self.out,
        )
        return self.out


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """Where a descent ended; `pose` is (3, 4), R and t: no value is made and checked at every step."""

    pose: FloatArray
    offset_mm: float
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
    require_same_frame(boundary.points.frame, start.source, "boundary registration")
    require_same_frame(boundary.target.frame, start.target, "boundary registration")
    opts = options or BoundaryFitOptions()
    problem = BoundaryProblem(boundary, center_mm)
    return _fit_of(problem, start, _descend(problem, start, opts), opts)


def _descend(problem: BoundaryProblem, start: Rigid, opts: BoundaryFitOptions) -> _End:
    pose, offset, used, converged = start.matrix[:3], opts.expected_offset_mm, 0, False
    for level, sigma in enumerate(opts.sigmas_mm):
        last = level == len(opts.sigmas_mm) - 1
        size = UNKNOWNS if sigma <= opts.free_offset_mm else UNKNOWNS - 1
        for _ in range(opts.last_steps if last else opts.steps):
            step = _step(problem.sums(pose, offset, sigma), offset, size, opts)
            used += 1
            pose = _moved(pose, step, problem.center_mm)
            offset += float(step[6])
            converged = float(np.linalg.norm(step)) < opts.tolerance_mm * (1 if last else 10)
            if converged:
                break
    return _End(pose, offset, converged, used)


def _moved(pose: FloatArray, xi_mm: FloatArray, center_mm: FloatArray) -> FloatArray:
    """(3, 4) R and t after a step in the coordinates of `PoseChart`."""
    turn = Rotation.from_rotvec(xi_mm[:3] / HEART_RADIUS_MM).as_matrix()
    out = turn @ pose
    out[:, 3] += center_mm - turn @ center_mm + xi_mm[3:6]
    return np.asarray(out)


def _step(sums: FloatArray, offset_mm: float, size: int, opts: BoundaryFitOptions) -> FloatArray:
    """(7,) Gauss–Newton step of the first `size` unknowns, the others 0; none where nothing matches."""
    matrix, right = normal_matrix(sums), sums[RIGHT:SHARE]
    curvature = matrix[:size, :size].copy()
    downhill = -right[:size]
    if size == UNKNOWNS:
        prior = POINTS_PER_OBSERVATION * (NEAR_MM / opts.offset_sigma_mm) ** 2
        curvature[6, 6] += prior
        downhill[6] -= prior * (offset_mm - opts.expected_offset_mm)
    mean = float(np.trace(matrix[:6, :6])) / 6
    step = np.zeros(UNKNOWNS)
    if mean > 0:
        step[:size] = np.linalg.solve(curvature + 1e-3 * mean * np.eye(size), downhill)
    length = float(np.linalg.norm(step[:6]))
    return step * min(1.0, opts.cap_mm / max(length, 1e-12))


def _fit_of(problem: BoundaryProblem, start: Rigid, end: _End, opts: BoundaryFitOptions) -> BoundaryFit:
    sigma = opts.sigmas_mm[-1]
    sums = problem.sums(end.pose, end.offset_mm, sigma)
    distance, agreement = np.empty((2, len(problem.points.points)))
    boundary_residuals(problem.points, problem.splines, end.pose, distance, agreement)
    apart = distance - end.offset_mm
    near = (np.abs(apart) < NEAR_MM) & (agreement > 0)
    weight = problem.points.weights
    residual = float(np.sqrt(np.mean(apart[near] ** 2))) if near.any() else float("nan")
    return BoundaryFit(
        pose=Rigid(start.target, start.source, nearest_rotation(end.pose[:, :3]), end.pose[:, 3]),
        offset_mm=end.offset_mm,
        share_near=float(weight[near].sum()) / problem.total,
        residual_mm=residual,
        covariance=_covariance(sums, opts),
        score=float(sums[SHARE]) / problem.total,
        converged=end.converged and bool(near.any()),
        evaluations=end.evaluations,
    )


def normal_matrix(sums: FloatArray) -> FloatArray:
    """(7, 7) JᵀωJ."""
    return sums[:RIGHT].reshape(UNKNOWNS, UNKNOWNS)


def _covariance(sums: FloatArray, opts: BoundaryFitOptions) -> FloatArray:
    """Of the pose with the offset unknown: inverse curvature times the variance of one observation."""
    matrix = normal_matrix(sums)
    size = UNKNOWNS if opts.free_offset_mm > 0 else UNKNOWNS - 1
    curvature = matrix[:size, :size]
    weight = float(matrix[6, 6])
    if not weight > 0 or np.linalg.cond(curvature) > 1e10:
        return np.full((6, 6), np.nan)
    variance = POINTS_PER_OBSERVATION * float(sums[SQUARES]) / weight
    return covariance_from_mm(np.asarray((variance * np.linalg.inv(curvature))[:6, :6], dtype=np.float64))


def boundary_starts(
    boundary: Boundary,
    start: Rigid,
    center_mm: FloatArray,
    *,
    rng: np.random.Generator,
    count: int = 24,
    spread_mm: float = 12.0,
    keep: int = 5,
    options: BoundaryFitOptions | None = None,
) -> tuple[BoundaryFit, ...]:
    """Quick fits from the start and displaced copies of it; the best distinct ends finish on all points.

    Args:
        rng: draws the displacements, of length `spread_mm` in the coordinates of `PoseChart`.
        count: displaced copies; keep: at most so many ends.
    Returns:
        ends by `score`, best first; see the module docstring on ranking them.
    """
    opts = options or BoundaryFitOptions()
    quick_options = replace(
        opts, sigmas_mm=opts.sigmas_mm[:-1] or opts.sigmas_mm, last_steps=4, tolerance_mm=0.05
    )
    finish = replace(opts, sigmas_mm=opts.sigmas_mm[-3:])
    few = replace(boundary, points=boundary.points.subsampled(QUICK_POINTS))
    displacements = random_displacements(rng, count, spread_mm)
    chart = PoseChart(start, np.asarray(center_mm))
    quick = [
        fit_boundary(few, chart.pose(xi), center_mm, options=quick_options)
        for xi in np.vstack([np.zeros(6), displacements])
    ]
    best = _best_distinct(quick, chart.center_mm, keep)
    finished = [fit_boundary(boundary, fit.pose, center_mm, options=finish) for fit in best]
    return _best_distinct(finished, chart.center_mm, keep)


def _best_distinct(fits: Sequence[BoundaryFit], center_mm: FloatArray, count: int) -> tuple[BoundaryFit, ...]:
    """The best fits that are not one another's neighbours, best first."""
    ranked = sorted(fits, key=lambda f: -f.score)
    return tuple(ranked[k] for k in distinct([fit.pose for fit in ranked], center_mm)[:count])
