"""Fit boundary points to the model's signed distance: robust Gauss–Newton, some milliseconds a start.

The scale σ of Geman–McClure is annealed from 12 to 2 mm: a far start is first pulled by everything, at last
only by what lies on the surface. Ultrasound blooms walls into the blood by up to a millimetre, everywhere
alike: a uniform offset along the normal is a seventh unknown once σ <= 4 mm (docs/theory/registration.md,
section 3). Many starts are fitted quickly on few points, and the best distinct ends on all of them.
Rank the ends of many starts by image similarity, not by `score`: the boundary alone prefers wrong optima at
times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import (
    HEART_RADIUS_MM,
    BoolArray,
    FloatArray,
    IntArray,
    Rigid,
    read_only_arrays,
    require_same_frame,
)
from dvf_ig.core.space.rigid import nearest_rotation
from dvf_ig.kernels.boundary import (
    RIGHT,
    SHARE,
    SQUARES,
    SUMS,
    UNKNOWNS,
    OrientedPoints,
    boundary_residuals,
    boundary_step_sums,
)
from dvf_ig.registration.pose_chart import PoseChart, covariance_from_mm, distinct, random_displacements

from .points import BoundaryPoints
from .target import BoundaryTarget

NEAR_MM = 2.0
"""A point lies on the surface where it is so near to it."""
POINTS_PER_OBSERVATION = 30.0
"""Neighbouring points share their difference from the model: with this divisor the standard deviations match
the errors of fits on tuning seeds 101–103."""
QUICK_POINTS = 800
"""Points of the quick first fits from many starts."""
STEPS, CAP_MM = 8, 8.0
"""Most steps at each scale but the last, and the longest step."""
FREE_OFFSET_MM, OFFSET_SIGMA_MM = 4.0, 1.0
"""The offset is free at scales up to the first; its standard deviation before the fit."""


@dataclass(frozen=True, slots=True)
class BoundaryFitOptions:
    """How boundary points are fitted to a surface.

    Attributes:
        sigmas_mm: scales, from far to near.
        last_steps: most at the last scale.
        tolerance_mm: a step shorter than this ends the last scale; ten times as long a one ends the others.
    """

    sigmas_mm: tuple[float, ...] = (12.0, 8.0, 5.5, 4.0, 2.8, 2.0)
    last_steps: int = 12
    tolerance_mm: float = 0.02


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
            points.points_mm, points.normals, points.weights, target.nearest_phase(points.model_phase)
        )
        self.splines = target.splines
        self.center_mm = np.array(center_mm, dtype=np.float64)
        self.total = float(points.weights.sum())

    def require_frames_of(self, start: Rigid) -> None:
        require_same_frame(self.source, start.source, "boundary registration")
        require_same_frame(self.target, start.target, "boundary registration")

    def sums(self, poses: FloatArray, offsets_mm: FloatArray, sigma_mm: float) -> FloatArray:
        """(m, SUMS) of `boundary_step_sums` at each of (m, 3, 4) poses."""
        out = np.empty((len(poses), SUMS))
        writable = np.array(poses)  # kernels are compiled again for read-only arrays
        for pose, offset_mm, sums in zip(writable, offsets_mm.tolist(), out, strict=True):
            boundary_step_sums(
                self.points, self.splines, pose, self.center_mm, HEART_RADIUS_MM, offset_mm, sigma_mm, sums
            )
        return out


def normal_matrices(sums: FloatArray) -> FloatArray:
    """(m, 7, 7) JᵀωJ."""
    return sums[:, :RIGHT].reshape(-1, UNKNOWNS, UNKNOWNS)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class DescentEnds:
    """Where m descents ended; `poses` is (m, 3, 4), R and t: no value is made and checked at every step."""

    poses: FloatArray
    offsets_mm: FloatArray
    converged: BoolArray
    evaluations: IntArray


def descend(problem: BoundaryProblem, starts: Sequence[Rigid], opts: BoundaryFitOptions) -> DescentEnds:
    """Descents from all starts, side by side: a step of one costs less than the calls it takes."""
    problem.require_frames_of(starts[0])
    poses = np.stack([start.matrix[:3] for start in starts])
    offsets = np.zeros(len(starts))
    converged, used = np.zeros(len(starts), dtype=np.bool_), np.zeros(len(starts), dtype=np.int64)
    for level, sigma in enumerate(opts.sigmas_mm):
        last = level == len(opts.sigmas_mm) - 1
        size = UNKNOWNS if sigma <= FREE_OFFSET_MM else UNKNOWNS - 1
        tolerance_mm = opts.tolerance_mm * (1 if last else 10)
        going = np.arange(len(starts))
        for _ in range(opts.last_steps if last else STEPS):
            sums = problem.sums(poses[going], offsets[going], sigma)
            steps = _steps(sums, offsets[going], size)
            used[going] += 1
            poses[going] = _moved(poses[going], steps, problem.center_mm)
            offsets[going] += steps[:, 6]
            converged[going] = np.linalg.norm(steps, axis=1) < tolerance_mm
            going = going[~converged[going]]
            if len(going) == 0:
                break
    return DescentEnds(poses, offsets, converged, used)


def _moved(poses: FloatArray, xi_mm: FloatArray, center_mm: FloatArray) -> FloatArray:
    """(m, 3, 4) R and t after steps (m, >= 6) in the coordinates of `PoseChart`."""
    turns = Rotation.from_rotvec(xi_mm[:, :3] / HEART_RADIUS_MM).as_matrix()
    out = turns @ poses
    out[:, :, 3] += center_mm - turns @ center_mm + xi_mm[:, 3:6]
    return np.asarray(out)


def _steps(sums: FloatArray, offsets_mm: FloatArray, size: int) -> FloatArray:
    """(m, 7) Gauss–Newton steps of the first `size` unknowns, the others 0; none where nothing matches."""
    matrices = normal_matrices(sums)
    curvature, downhill = matrices[:, :size, :size].copy(), -sums[:, RIGHT : RIGHT + size]
    if size == UNKNOWNS:
        prior = POINTS_PER_OBSERVATION * (NEAR_MM / OFFSET_SIGMA_MM) ** 2
        curvature[:, 6, 6] += prior
        downhill[:, 6] -= prior * offsets_mm
    mean = np.trace(matrices[:, :6, :6], axis1=1, axis2=2) / 6
    steps, matched = np.zeros((len(sums), UNKNOWNS)), mean > 0
    damped = curvature[matched] + 1e-3 * mean[matched, None, None] * np.eye(size)
    steps[matched, :size] = np.linalg.solve(damped, downhill[matched, :, None])[:, :, 0]
    length = np.linalg.norm(steps[:, :6], axis=1, keepdims=True)
    return np.asarray(steps * np.minimum(1.0, CAP_MM / np.maximum(length, 1e-12)))


def pose_of(start: Rigid, pose: FloatArray) -> Rigid:
    """(3, 4) R and t as a rigid map between the frames of `start`."""
    return Rigid(start.target, start.source, nearest_rotation(pose[:, :3]), pose[:, 3])


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


def fit_boundary(boundary: Boundary, start: Rigid, center_mm: FloatArray) -> BoundaryFit:
    """Register boundary points to the surface from one start.

    Args:
        boundary: points in the frame of `start.source`, surface in that of `start.target`.
        center_mm: (3,) centre of the heart box in the target frame, about which the pose turns.
    Raises:
        FrameMismatchError: frames do not meet.
    """
    opts = BoundaryFitOptions()
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
        covariance=_covariance(sums),
        score=float(sums[SHARE]) / problem.total,
        converged=bool(ends.converged[k] and near.any()),
        evaluations=int(ends.evaluations[k]),
    )


def _covariance(sums: FloatArray) -> FloatArray:
    """(6, 6) of the pose with the offset unknown: inverse curvature times the variance of one observation."""
    curvature = normal_matrices(sums[None])[0]
    weight = float(curvature[6, 6])
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
) -> tuple[BoundaryFit, ...]:
    """Quick fits from the start and displaced copies of it; the best distinct ends finish on all points.

    Args:
        rng: draws the displacements, of length `spread_mm` in the coordinates of `PoseChart`.
        count: displaced copies; keep: most ends that are returned.
    Returns:
        ends by `score`, best first; see the module docstring on ranking them.
    """
    opts = BoundaryFitOptions()
    quick_options = replace(
        opts, sigmas_mm=opts.sigmas_mm[:-1] or opts.sigmas_mm, last_steps=4, tolerance_mm=0.05
    )
    finish = replace(opts, sigmas_mm=opts.sigmas_mm[-3:])
    few = replace(boundary, points=boundary.points.subsampled(QUICK_POINTS))
    displacements = random_displacements(rng, count, spread_mm)
    chart = PoseChart(start, np.asarray(center_mm))
    starts = [chart.pose(xi) for xi in np.vstack([np.zeros(6), displacements])]
    best = _best_distinct(_scored(few, starts, chart.center_mm, quick_options), chart.center_mm, keep)
    problem = BoundaryProblem(boundary, chart.center_mm)
    ends = descend(problem, [pose for _, pose in best], finish)
    finished = [fit_at_end(problem, start, ends, k, finish) for k in range(len(best))]
    ranked = _best_distinct([(fit.score, fit.pose) for fit in finished], chart.center_mm, keep)
    return tuple(fit for _, pose in ranked for fit in finished if fit.pose is pose)


def _scored(
    boundary: Boundary, starts: Sequence[Rigid], center_mm: FloatArray, opts: BoundaryFitOptions
) -> list[tuple[float, Rigid]]:
    """Score and pose of the end of every start."""
    problem = BoundaryProblem(boundary, center_mm)
    ends = descend(problem, starts, opts)
    scores = problem.sums(ends.poses, ends.offsets_mm, opts.sigmas_mm[-1])[:, SHARE] / problem.total
    return [(float(score), pose_of(starts[0], pose)) for score, pose in zip(scores, ends.poses, strict=True)]


def _best_distinct(
    scored: Sequence[tuple[float, Rigid]], center_mm: FloatArray, count: int
) -> list[tuple[float, Rigid]]:
    """The best-scored poses that are not one another's neighbours, best first."""
    ranked = sorted(scored, key=lambda entry: -entry[0])
    return [ranked[k] for k in distinct([pose for _, pose in ranked], center_mm)[:count]]
