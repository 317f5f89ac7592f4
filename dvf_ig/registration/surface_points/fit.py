"""A start pose from points touched on the heart: many ICP fits, judged by the distance of the model.

Some forty points on the surface that can be reached give a start without an image or paired landmarks. What
they cannot tell is said: directions along which the surface slides on itself, and a second pose that explains
the points about as well (docs/theory/registration.md).
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import (
    BoolArray,
    DvfModel,
    FloatArray,
    Rigid,
    Stop,
    mean_displacement_mm,
    read_only_arrays,
    require_same_frame,
)
from dvf_ig.registration.evidence.least_constrained import LeastConstrained, least_constrained_direction
from dvf_ig.registration.pose_chart import covariance_from_mm, distinct

from .descent import REACH, DescentEnd, descend, robust_cost, robust_weights
from .distance import SurfaceDistance
from .icp import SurfaceIcp
from .starts import starts_about, starts_everywhere
from .touched import TouchedPoints, require_spread

MAX_SIGMA_RATIO = 2.0
"""Points may scatter about the surface by so many times their stated standard deviation."""
INLIER = 3.0
"""An inlier lies within so many standard deviations of the surface."""
MIN_INLIER_SHARE = 0.7
"""With a smaller share of inliers there is no pose."""
MAX_WEAK_SIGMA_MM = 3.0
"""Standard deviation at the heart's radius from which a direction counts as undetermined."""
MIN_COST_GAP = 8.0
"""A runner-up that is not e⁸ times less likely than the pose leaves it ambiguous: points share errors that a
likelihood of independent ones does not know. On tuning seeds 101–106 wrong poses had gaps up to 8, good poses
of 40 points and more from 10 on."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RunnerUp:
    """The best other pose, more than 4 mm away: where it is, and how much less likely.

    Attributes:
        target_from_source: the other pose.
        cost_gap: log of the likelihood ratio of the pose to this one.
        apart_mm: mean distance between the two over the heart.
    """

    target_from_source: Rigid
    cost_gap: float
    apart_mm: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SurfacePointFit:
    """A pose fitted to touched points, with its evidence. `stop.usable` says whether it may start anything.

    Attributes:
        target_from_source: the pose; the frames are in the value.
        stop: how it ended.
        residuals_mm: (n,) signed distance of each point, positive inside; not an accuracy.
        inliers: (n,) points within INLIER standard deviations of the surface.
        sigma_mm: standard deviation of a point as seen, at least the one stated.
        covariance: (6, 6) rad², mm²; rotation vector then translation, left perturbation about `center_mm`.
        center_mm: (3,) centre of the heart box in the target frame.
        weakest: the least-constrained direction.
        cost: −log of the robust likelihood.
        runner_up: None where every start ended at one pose.
        starts: how many were tried.
    """

    target_from_source: Rigid
    stop: Stop
    residuals_mm: FloatArray
    inliers: BoolArray
    sigma_mm: float
    covariance: FloatArray
    center_mm: FloatArray
    weakest: LeastConstrained
    cost: float
    runner_up: RunnerUp | None
    starts: int

    @property
    def sentence(self) -> str:
        """How it ended, as a user reads it."""
        if self.stop is Stop.WEAK_GEOMETRY:
            kind = "turning about" if self.weakest.turning else "shifting along"
            x, y, z = self.weakest.axis
            return (
                f"the touched points leave the pose undetermined: {self.weakest.sigma_mm:.1f} mm by {kind} "
                f"({x:.1f}, {y:.1f}, {z:.1f}); touch other sides of the heart, its edges and grooves"
            )
        if self.stop is Stop.AMBIGUOUS and self.runner_up is not None:
            return (
                f"a pose {self.runner_up.apart_mm:.0f} mm away explains the touched points about as well; "
                "touch more of the surface or give a coarse start"
            )
        if self.stop is Stop.POOR_MATCH:
            return (
                f"{self.inliers.mean():.0%} of the touched points lie on the model's surface at the best "
                "pose found; check the stylus tip, the phase and the patient"
            )
        return str(self.stop.value)


def start_from_surface_points(
    touched: TouchedPoints,
    model: DvfModel,
    center_mm: FloatArray,
    *,
    rng: np.random.Generator,
    start: Rigid | None = None,
) -> SurfacePointFit:
    """mr_from_tracker from points touched on the surface of the beating heart.

    Args:
        touched: points with the phases at which they were touched.
        model: fixture model of that surface.
        center_mm: (3,) centre of the heart box in the model's frame.
        rng: draws starts about `start`; not used without one.
        start: coarse mr_from_tracker, some 20 mm and 20° off at most; None searches all rotations.
    Raises:
        InvalidInputError: too few points, or all on one small patch.
        FrameMismatchError: `start` does not map the points into the model's frame.
        MissingDependencyError: Open3D is absent.
    """
    require_spread(touched)
    icp = SurfaceIcp(touched, model, center_mm)
    if start is None:
        starts = starts_everywhere(touched, icp.surface_mm, model.frame)
    else:
        require_same_frame(touched.points.frame, start.source, "touched points")
        require_same_frame(model.frame, start.target, "start pose of touched points")
        starts = starts_about(start, center_mm, rng)
    distance = SurfaceDistance(touched, model, center_mm)
    ends = [descend(distance, icp.fit(each), touched.sigma_mm) for each in starts]
    ends.sort(key=lambda end: robust_cost(distance.residuals_mm(end.pose), touched.sigma_mm))
    return _judged(distance, ends, touched.sigma_mm)


def _judged(distance: SurfaceDistance, ends: list[DescentEnd], stated_mm: float) -> SurfacePointFit:
    """The best end, refined at the spread its residuals show, with its evidence."""
    sigma = _spread_mm(distance.residuals_mm(ends[0].pose), stated_mm)
    best = descend(distance, ends[0].pose, sigma, wide=False)
    residuals = distance.residuals_mm(best.pose)
    covariance = _covariance(distance, best.pose, sigma)
    weakest = least_constrained_direction(covariance)
    inliers = np.abs(residuals) <= INLIER * sigma
    cost = robust_cost(residuals, sigma)
    runner_up = _runner_up(distance, best.pose, [end.pose for end in ends], sigma)
    return SurfacePointFit(
        target_from_source=best.pose,
        stop=_stop(best.converged, inliers, weakest, runner_up),
        residuals_mm=residuals,
        inliers=inliers,
        sigma_mm=sigma,
        covariance=covariance,
        center_mm=distance.center_mm,
        weakest=weakest,
        cost=cost,
        runner_up=runner_up,
        starts=len(ends),
    )


def _spread_mm(residuals_mm: FloatArray, stated_mm: float) -> float:
    """Standard deviation from the median of |r|, between the stated one and MAX_SIGMA_RATIO times it."""
    seen = (
        1.4826 * float(np.median(np.abs(residuals_mm))) * np.sqrt(len(residuals_mm) / (len(residuals_mm) - 6))
    )
    return float(np.clip(seen, stated_mm, MAX_SIGMA_RATIO * stated_mm))


def _covariance(distance: SurfaceDistance, pose: Rigid, sigma_mm: float) -> FloatArray:
    """(6, 6): inverse weighted curvature; NaN where it is singular."""
    residuals, jacobian = distance.linearised(pose)
    weights = robust_weights(residuals, REACH * sigma_mm)
    curvature = jacobian.T @ (weights[:, None] * jacobian)
    if not np.linalg.cond(curvature) < 1e10:
        return np.full((6, 6), np.nan)
    return covariance_from_mm(np.asarray(sigma_mm**2 * np.linalg.inv(curvature), dtype=np.float64))


def _runner_up(
    distance: SurfaceDistance, best: Rigid, others: list[Rigid], sigma_mm: float
) -> RunnerUp | None:
    """The likeliest of the poses that lie elsewhere than `best`."""
    cost = [robust_cost(distance.residuals_mm(pose), sigma_mm) for pose in others]
    poses = [best, *(others[k] for k in np.argsort(cost, kind="stable"))]
    apart = distinct(poses, distance.center_mm)
    if len(apart) < 2:
        return None
    other = poses[apart[1]]
    gap = robust_cost(distance.residuals_mm(other), sigma_mm) - robust_cost(
        distance.residuals_mm(best), sigma_mm
    )
    return RunnerUp(other, gap, mean_displacement_mm(best, other, distance.center_mm))


def _stop(converged: bool, inliers: BoolArray, weakest: LeastConstrained, runner_up: RunnerUp | None) -> Stop:
    if inliers.mean() < MIN_INLIER_SHARE:
        return Stop.POOR_MATCH
    if not weakest.sigma_mm < MAX_WEAK_SIGMA_MM:
        return Stop.WEAK_GEOMETRY
    if runner_up is not None and runner_up.cost_gap < MIN_COST_GAP:
        return Stop.AMBIGUOUS
    return Stop.CONVERGED if converged else Stop.MAX_ITERATIONS
