"""A start pose from points touched on the heart: many ICP fits, judged by the distance of the model.

Some forty points on the surface that can be reached give a start without an image or paired landmarks. Starts
lie around a coarse pose, or are spread over all rotations. Robust point-to-plane ICP with Open3D comes near:
distances to the nearest triangle's centre at one phase under Tukey's biweight, whose reach shrinks (Chen and
Medioni 1992; Beaton and Tukey 1974). Gauss–Newton on the model's signed distance, phase by phase, finishes
each, with weights of Geman–McClure, ω = 1/(1 + r²/s²)², and s from far to near.

What points cannot determine is stated: directions along which the surface slides on itself, and a second pose
that explains the points about as well (docs/theory/registration.md, section 3).
"""

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import (
    BoolArray,
    DvfModel,
    FloatArray,
    MissingDependencyError,
    Rigid,
    Stop,
    TouchedPoints,
    mean_displacement_mm,
    nearest_phase,
    read_only_arrays,
    require_same_frame,
)
from dvf_ig.core.errors import install_extra
from dvf_ig.registration.evidence.covariance import LeastConstrained, least_constrained_direction
from dvf_ig.registration.pose_chart import PoseChart, covariance_from_mm, distinct, random_displacements

from .touched import SurfaceDistance, require_spread

AROUND, AROUND_MM = 24, 20.0
"""Displaced copies of a coarse start, and how far they are displaced at the heart's radius."""
ICP_REACH_MM = (25.0, 10.0)
"""Tukey's constant in turn: beyond it a point has no weight."""
ICP_STEPS = 25
"""Most steps with each constant."""
ICP_DIGITS = 2
"""A pose is rounded to this part of a millimetre: the order in which Open3D's threads sum must not show."""
REACH = 3.0
"""The last s in standard deviations of a point; then the estimate keeps 90 % of the efficiency of least
squares."""
WIDE_MM = (8.0, 5.0)
"""Scales before the last."""
STEPS, LAST_STEPS = 8, 40
"""Most steps at the wide scales, and at the last."""
CAP_MM = 8.0
"""Longest step."""
TOLERANCE_MM = 1e-4
"""A step shorter than this ends the last scale."""
DAMPING = 1e-3
"""In mean curvatures: undetermined directions take no steps."""
MAX_SIGMA_RATIO = 2.0
"""Largest scatter of the points about the surface, in their stated standard deviations."""
INLIER = 3.0
"""Largest distance of an inlier from the surface, in standard deviations."""
MIN_INLIER_SHARE = 0.7
"""With a smaller share of inliers there is no pose."""
MAX_WEAK_SIGMA_MM = 3.0
"""Standard deviation at the heart's radius from which a direction counts as undetermined."""
MIN_COST_GAP = 8.0
"""A runner-up that is not e⁸ times less likely than the pose leaves it ambiguous: points share errors that a
likelihood of independent ones does not know. On tuning seeds 101–106 wrong poses had gaps up to 8, good poses
of 40 points and more from 10 on."""


def starts_about(start: Rigid, center_mm: FloatArray, rng: np.random.Generator) -> list[Rigid]:
    """The start itself, then displaced copies of it."""
    chart = PoseChart(start, np.asarray(center_mm))
    return [start, *(chart.pose(xi) for xi in random_displacements(rng, AROUND, AROUND_MM))]


def starts_everywhere(touched: TouchedPoints, surface_mm: FloatArray, frame: str) -> list[Rigid]:
    """The 60 rotations of the icosahedron, none more than 45° from every one; centroids aligned.

    Args:
        surface_mm: (m, 3) points spread over the model's surface.
        frame: of the model.
    """
    middle, target = touched.points.xyz_mm.mean(axis=0), surface_mm.mean(axis=0)
    turns = Rotation.create_group("I").as_matrix()
    return [Rigid(frame, touched.points.frame, turn, target - turn @ middle) for turn in turns]


class SurfaceIcp:
    """Mesh and points as Open3D wants them, for many starts.

    Args:
        touched: points.
        model: fixture model; its surface at the phase that most points were touched nearest to is used,
            without the triangles that close an opening.
        center_mm: (3,) about which poses turn, the model's frame.
    Raises:
        MissingDependencyError: Open3D or a library that it loads is absent.
    """

    def __init__(self, touched: TouchedPoints, model: DvfModel, center_mm: FloatArray) -> None:
        self._open3d = _open3d()
        nearest = nearest_phase(model.timing.fractions, touched.model_phase)
        self.phase = int(np.bincount(nearest).argmax())
        self.surface_mm, normals = _triangle_centres(model, self.phase)
        self._center_mm = np.asarray(center_mm, dtype=np.float64)
        self._source = self._cloud(touched.points.xyz_mm)
        self._target = self._cloud(self.surface_mm)
        self._target.normals = self._open3d.utility.Vector3dVector(normals)

    def fit(self, start: Rigid) -> Rigid:
        """The pose near `start` at which the points lie on the mesh."""
        registration = self._open3d.pipelines.registration
        matrix = start.matrix
        for reach in ICP_REACH_MM:
            result = registration.registration_icp(
                self._source,
                self._target,
                2 * reach,
                matrix,
                registration.TransformationEstimationPointToPlane(registration.TukeyLoss(k=reach)),
                registration.ICPConvergenceCriteria(max_iteration=ICP_STEPS),
            )
            matrix = np.array(result.transformation)
        if not np.isfinite(matrix).all():
            return start
        chart = PoseChart(start, self._center_mm)
        xi = chart.coordinates(Rigid.from_matrix(matrix, start.target, start.source))
        return chart.pose(np.round(xi, ICP_DIGITS))

    def _cloud(self, xyz_mm: FloatArray) -> Any:
        return self._open3d.geometry.PointCloud(self._open3d.utility.Vector3dVector(np.array(xyz_mm)))


def _triangle_centres(model: DvfModel, phase: int) -> tuple[FloatArray, FloatArray]:
    """(m, 3) centres and (m, 3) unit outward normals of the measured triangles of one phase."""
    mesh = model.reference[phase]
    corners = mesh.vertices_mm[mesh.triangles[~model.reference_caps[phase]]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    solid = area > 0
    return corners[solid].mean(axis=1), normals[solid] / area[solid, None]


def _open3d() -> Any:
    try:
        return importlib.import_module("open3d")
    except (ImportError, OSError) as exc:
        raise MissingDependencyError(
            f"fitting touched surface points needs Open3D ({exc}); {install_extra('open3d')} "
            "(`dvf-ig doctor` names system libraries that it lacks)"
        ) from exc


@dataclass(frozen=True, slots=True, eq=False)
class DescentEnd:
    """Where a descent ended, and whether its last step was shorter than TOLERANCE_MM."""

    pose: Rigid
    converged: bool


def descend(distance: SurfaceDistance, start: Rigid, sigma_mm: float, *, wide: bool = True) -> DescentEnd:
    """The robust optimum next to `start`.

    Args:
        sigma_mm: standard deviation of a point.
        wide: begin with the wide scales.
    """
    pose, converged = start, False
    last = REACH * sigma_mm
    for scale in (*(s for s in WIDE_MM if wide and s > last), last):
        for _ in range(LAST_STEPS if scale == last else STEPS):
            step = _step(distance, pose, scale)
            pose = PoseChart(pose, distance.center_mm).pose(step)
            length = float(np.linalg.norm(step))
            converged = scale == last and length < TOLERANCE_MM
            if length < (TOLERANCE_MM if scale == last else 0.05):
                break
    return DescentEnd(pose, converged)


def robust_cost(residuals_mm: FloatArray, sigma_mm: float) -> float:
    """−log of a robust likelihood, ½ Σ (r/σ)²/(1 + r²/s²): an outlier costs REACH²/2 at most."""
    square = (residuals_mm / sigma_mm) ** 2
    return float(0.5 * (square / (1.0 + square / REACH**2)).sum())


def robust_weights(residuals_mm: FloatArray, scale_mm: float) -> FloatArray:
    """(n,) ω."""
    return np.asarray(1.0 / (1.0 + (residuals_mm / scale_mm) ** 2) ** 2)


def _step(distance: SurfaceDistance, pose: Rigid, scale_mm: float) -> FloatArray:
    """(6,) in the coordinates of `PoseChart`."""
    residuals, jacobian = distance.linearised(pose)
    weighted = jacobian * robust_weights(residuals, scale_mm)[:, None]
    curvature = weighted.T @ jacobian
    mean = float(np.trace(curvature)) / 6
    if not mean > 0:
        return np.zeros(6)
    step = -np.linalg.solve(curvature + DAMPING * mean * np.eye(6), weighted.T @ residuals)
    return np.asarray(step * min(1.0, CAP_MM / max(float(np.linalg.norm(step)), 1e-12)))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RunnerUp:
    """The best other pose, more than 4 mm away, and how much less likely it is.

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
        runner_up: None if every start ended at one pose.
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
    """(6, 6): inverse weighted curvature; NaN if it is singular."""
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
