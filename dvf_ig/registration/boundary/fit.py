"""Register border points to the model's signed distance: robust Gauss–Newton, some milliseconds a start.

The scale σ of Geman–McClure is annealed from 12 to 2 mm: a far start is first pulled by everything, at last
only by what lies on the surface. Ultrasound blooms walls into the blood by up to a millimetre, alike
everywhere: a uniform offset along the normal is a seventh unknown once σ <= 4 mm
(dvf_ig/docs/theory/registration.md).
Rank the ends of many starts by image similarity, not by `score`: edges alone prefer wrong basins at times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import FloatArray, Rigid, read_only_arrays, require_same_frame
from dvf_ig.core.rigid import nearest_rotation
from dvf_ig.kernels.boundary import SUMS, UNKNOWNS, edge_residuals, edge_step_sums
from dvf_ig.registration.pose_chart import HEART_RADIUS_MM, PoseChart, distance_between

from .points import BoundaryPoints
from .target import EdgeTarget

NEAR_MM = 2.0
APART_MM = 4.0
"""Ends nearer to each other than this over the heart are one."""
POINTS_PER_OBSERVATION = 30.0
"""Neighbouring points share their difference from the model: with this divisor the standard deviations match
the errors of fits on tuning seeds 101–103."""


@dataclass(frozen=True, slots=True)
class EdgeFitOptions:
    """Attributes:
    sigmas_mm: scales, from far to near.
    steps: at each scale but the last.
    last_steps: most at the last scale.
    free_offset_mm: the offset is free at scales up to this; 0 keeps it at the expected one.
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


EPICARDIUM_FIT = EdgeFitOptions(free_offset_mm=12.0, expected_offset_mm=-4.0, offset_sigma_mm=3.0)
"""For the surface of a fixture model. Ultrasound shows the pericardium there, which lies outside of the
epicardium by the fat between them (5.5 mm on tuning seeds 101–103): the offset is free from the start."""
QUICK_POINTS = 800


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Borders seen in the ultrasound, and the model's surface that they should lie on."""

    points: BoundaryPoints
    target: EdgeTarget


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class EdgeFit:
    """Attributes:
    pose: fixed_from_moving.
    offset_mm: distance of the points from the surface, positive inside, common to all.
    share_near: share of the weight within NEAR_MM of the surface with agreeing normals.
    residual_mm: RMS of d − offset over those.
    covariance: (6, 6) rad², mm²; rotation first, left perturbation about the centre; NaN if singular.
    score: share of the weight that lies on the surface, soft at the last scale.
    converged: whether it came to rest.
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


class _Problem:
    """Points and target as the kernels want them, with one buffer; serves one thread."""

    def __init__(self, points: BoundaryPoints, target: EdgeTarget, center_mm: FloatArray) -> None:
        self.data = (
            points.points_mm,
            points.normals,
            points.weights,
            target.nearest_phase(points.model_phase),
        )
        self.target = target
        self.center_mm = np.array(center_mm, dtype=np.float64)
        self.total = float(points.weights.sum())
        self.out = np.empty(SUMS)

    def sums(
        self, pose: FloatArray, offset_mm: float, sigma_mm: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(7, 7) curvature, (7,) slope, (3,) other sums at a (3, 4) pose: views of the buffer."""
        edge_step_sums(
            *self.data,
            self.target.coefficients,
            self.target.knots_from_mm,
            self.target.brighter,
            pose,
            self.center_mm,
            HEART_RADIUS_MM,
            offset_mm,
            sigma_mm,
            self.out,
        )
        square = UNKNOWNS * UNKNOWNS
        return self.out[:square].reshape(UNKNOWNS, UNKNOWNS), self.out[square:-3], self.out[-3:]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """Where a descent ended; `pose` is (3, 4), R and t: no value is made and checked at every step."""

    pose: FloatArray
    offset_mm: float
    rested: bool
    evaluations: int


def fit_edges(
    points: BoundaryPoints,
    target: EdgeTarget,
    start: Rigid,
    center_mm: FloatArray,
    *,
    options: EdgeFitOptions | None = None,
) -> EdgeFit:
    """Register border points to the surface from one start.

    Args:
        points: frame of `start.source`; target: frame of `start.target`.
        center_mm: (3,) centre of the heart box in the fixed frame, about which the pose turns.
    Raises:
        FrameMismatchError: frames do not meet.
    """
    require_same_frame(points.frame, start.source, "edge registration")
    require_same_frame(target.frame, start.target, "edge registration")
    opts = options or EdgeFitOptions()
    problem = _Problem(points, target, center_mm)
    return _judged(problem, start, _descend(problem, start, opts), opts)


def _descend(problem: _Problem, start: Rigid, opts: EdgeFitOptions) -> _End:
    pose, offset, used, rested = start.matrix[:3], opts.expected_offset_mm, 0, False
    for level, sigma in enumerate(opts.sigmas_mm):
        last = level == len(opts.sigmas_mm) - 1
        size = UNKNOWNS if sigma <= opts.free_offset_mm else UNKNOWNS - 1
        for _ in range(opts.last_steps if last else opts.steps):
            matrix, right, _ = problem.sums(pose, offset, sigma)
            used += 1
            step = _step(matrix, right, offset, size, opts)
            pose = _moved(pose, step, problem.center_mm)
            offset += float(step[6])
            rested = float(np.linalg.norm(step)) < opts.tolerance_mm * (1 if last else 10)
            if rested:
                break
    return _End(pose, offset, rested, used)


def _moved(pose: FloatArray, xi_mm: FloatArray, center_mm: FloatArray) -> FloatArray:
    """(3, 4) R and t after a step in the coordinates of `chart`."""
    turn = Rotation.from_rotvec(xi_mm[:3] / HEART_RADIUS_MM).as_matrix()
    out = turn @ pose
    out[:, 3] += center_mm - turn @ center_mm + xi_mm[3:6]
    return np.asarray(out)


def _step(
    matrix: FloatArray, right: FloatArray, offset_mm: float, size: int, opts: EdgeFitOptions
) -> FloatArray:
    """(7,) Gauss–Newton step of the first `size` unknowns, the others 0; none where nothing matches."""
    curvature = matrix[:size, :size].copy()
    downhill = -right[:size]
    if size == UNKNOWNS:
        hold = POINTS_PER_OBSERVATION * (NEAR_MM / opts.offset_sigma_mm) ** 2
        curvature[6, 6] += hold
        downhill[6] -= hold * (offset_mm - opts.expected_offset_mm)
    mean = float(np.trace(matrix[:6, :6])) / 6
    step = np.zeros(UNKNOWNS)
    if mean > 0:
        step[:size] = np.linalg.solve(curvature + 1e-3 * mean * np.eye(size), downhill)
    length = float(np.linalg.norm(step[:6]))
    return step * min(1.0, opts.cap_mm / max(length, 1e-12))


def _judged(problem: _Problem, start: Rigid, end: _End, opts: EdgeFitOptions) -> EdgeFit:
    sigma = opts.sigmas_mm[-1]
    matrix, _, tail = problem.sums(end.pose, end.offset_mm, sigma)
    distance, agreement = np.empty((2, len(problem.data[0])))
    edge_residuals(
        problem.data[0],
        problem.data[1],
        problem.data[3],
        problem.target.coefficients,
        problem.target.knots_from_mm,
        problem.target.brighter,
        end.pose,
        distance,
        agreement,
    )
    apart = distance - end.offset_mm
    near = (np.abs(apart) < NEAR_MM) & (agreement > 0)
    weight = problem.data[2]
    residual = float(np.sqrt(np.mean(apart[near] ** 2))) if near.any() else float("nan")
    return EdgeFit(
        pose=Rigid(start.target, start.source, nearest_rotation(end.pose[:, :3]), end.pose[:, 3]),
        offset_mm=end.offset_mm,
        share_near=float(weight[near].sum()) / problem.total,
        residual_mm=residual,
        covariance=_covariance(matrix, float(tail[2]), opts),
        score=float(tail[0]) / problem.total,
        converged=end.rested and bool(near.any()),
        evaluations=end.evaluations,
    )


def _covariance(matrix: FloatArray, squares: float, opts: EdgeFitOptions) -> FloatArray:
    """Of the pose with the offset unknown: inverse curvature times the variance of one observation."""
    size = UNKNOWNS if opts.free_offset_mm > 0 else UNKNOWNS - 1
    curvature = matrix[:size, :size]
    weight = float(matrix[6, 6])
    if not weight > 0 or np.linalg.cond(curvature) > 1e10:
        return np.full((6, 6), np.nan)
    variance = POINTS_PER_OBSERVATION * squares / weight
    unit = np.diag([1 / HEART_RADIUS_MM] * 3 + [1.0] * 3)
    return np.asarray(unit @ (variance * np.linalg.inv(curvature))[:6, :6] @ unit)


def edge_starts(
    points: BoundaryPoints,
    target: EdgeTarget,
    start: Rigid,
    center_mm: FloatArray,
    *,
    rng: np.random.Generator,
    count: int = 24,
    spread_mm: float = 12.0,
    keep: int = 5,
    options: EdgeFitOptions | None = None,
) -> tuple[EdgeFit, ...]:
    """Quick fits from the start and displaced copies of it; the best distinct ends finish on all points.

    Args:
        rng: draws the displacements, of length `spread_mm` in the coordinates of `chart`.
        count: displaced copies; keep: at most so many ends.
    Returns:
        ends by `score`, best first; see the module docstring on ranking them.
    """
    opts = options or EdgeFitOptions()
    look = replace(opts, sigmas_mm=opts.sigmas_mm[:-1] or opts.sigmas_mm, last_steps=4, tolerance_mm=0.05)
    finish = replace(opts, sigmas_mm=opts.sigmas_mm[-3:])
    few = points.thinned(QUICK_POINTS)
    directions = rng.normal(size=(count, 6))
    directions *= spread_mm / np.linalg.norm(directions, axis=1, keepdims=True)
    chart = PoseChart(start, np.asarray(center_mm))
    quick = [
        fit_edges(few, target, chart.pose(xi), center_mm, options=look)
        for xi in np.vstack([np.zeros(6), directions])
    ]
    best = _distinct(quick, chart.center_mm, keep)
    finished = [fit_edges(points, target, fit.pose, center_mm, options=finish) for fit in best]
    return _distinct(finished, chart.center_mm, keep)


def _distinct(fits: Sequence[EdgeFit], center_mm: FloatArray, count: int) -> tuple[EdgeFit, ...]:
    """The best fits that are not one another's neighbours, best first."""
    chosen: list[EdgeFit] = []
    for fit in sorted(fits, key=lambda f: -f.score):
        if all(distance_between(fit.pose, known.pose, center_mm) > APART_MM for known in chosen):
            chosen.append(fit)
    return tuple(chosen[:count])
