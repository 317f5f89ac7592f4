"""Quasi-Newton optimisation of LC2 over the pose: about ten steps where a derivative-free search needs 100.

The gradient is exact (`kernels.lc2.step`). The curvature starts as that of Gauss–Newton with the coefficients
of the local fits fixed, divided by FIXED_FIT_STIFFNESS: fixed fits make a minimum appear that much narrower,
because α and β would have followed. From then on it is updated from how the gradient changes (BFGS).
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dvf_ig.core import FloatArray, Rigid, read_only_arrays
from dvf_ig.registration.pose_chart import PoseChart

from .lc2 import NormalEquations, Slope

DAMPING = 1e-3
"""Share of each coordinate's curvature that is added to it: undetermined directions take no steps."""
FIXED_FIT_STIFFNESS = 6.0
"""Gauss–Newton's eigenvalues over the true ones: 8 to 12 at the optimum (tuning seeds 102, 106), less away
from it."""
STEP_REDUCTION = 0.3
"""Factor of the next step's length after one that raised the cost."""
MIN_CURVATURE_SHARE = 0.05
"""The curvature learnt along a step is at least this share of what was expected (Powell's damping)."""
MAX_REJECTED = 8
"""Steps in a row that raised the cost, after which the search ends."""
PRIOR_SIGMA_MM = 6.0
"""Standard deviation per coordinate: bounds what a beat, or a part of the slices, cannot observe."""


class PoseMetric(Protocol):
    """A similarity with an exact gradient: `Lc2` on slices, `VolumeLc2` on a volume."""

    def normal_equations(self, target_from_source: Rigid, center_mm: FloatArray) -> NormalEquations: ...

    def slope(self, target_from_source: Rigid, center_mm: FloatArray) -> Slope: ...

    @property
    def information(self) -> float: ...


class PosePrior(Protocol):
    """Knowledge of a pose in addition to the image, as −log of its likelihood (see `LandmarkPrior`)."""

    def energy(self, pose: Rigid) -> float: ...

    def normal_equations(self, pose: Rigid, center_mm: FloatArray) -> tuple[FloatArray, FloatArray]: ...


@dataclass(frozen=True, slots=True)
class OptimiserOptions:
    """When the optimiser ends, and its longest step.

    Attributes:
        steps: most evaluations.
        cap_mm: longest step.
        tolerance_mm: a step shorter than this ends the search.
    """

    steps: int
    cap_mm: float
    tolerance_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Optimum:
    """Where a search ended.

    Attributes:
        pose: target_from_source.
        cost: −log posterior per observation (see `optimise`).
        evaluations: effort.
        converged: whether the last step was shorter than the tolerance, or none lowered the cost any more.
    """

    pose: Rigid
    cost: float
    evaluations: int
    converged: bool


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Local:
    """Cost and its gradient (6,)."""

    cost: float
    gradient: FloatArray


def optimise(
    metric: PoseMetric,
    start: Rigid,
    center_mm: FloatArray,
    prior: PosePrior | None,
    options: OptimiserOptions,
) -> Optimum:
    """Minimise −log posterior per observation from `start`.

    With S the explained share of variance over n observations, −n/2·log(1 − S) is the log likelihood of the
    local linear model up to a constant; touched landmarks, if any, add their own. Images that hold no
    observation, as where no pixel lies within the model, say nothing: the search ends where it began, not
    converged.

    Args:
        center_mm: (3,) about which poses turn, target frame.
        prior: what the pose must also agree with, as touched landmarks.
    """
    if metric.information <= 0.0:
        return Optimum(start, 0.0, 0, False)
    pose, (here, curvature) = start, _first(metric, start, center_mm, prior)
    used, rejected = 1, 0
    while used < options.steps:
        damped = curvature + DAMPING * np.diag(np.diag(curvature)) + 1e-12 * np.eye(6)
        step = -np.linalg.solve(damped, here.gradient).astype(np.float64)
        length = float(np.linalg.norm(step))
        step *= min(1.0, options.cap_mm / max(length, 1e-12))
        tried = PoseChart(pose, center_mm).pose(step)
        there = _local(metric, metric.slope(tried, center_mm), tried, center_mm, prior)
        used += 1
        curvature = _bfgs(curvature, step, there.gradient - here.gradient)
        if there.cost < here.cost:
            pose, here, rejected = tried, there, 0
        else:
            curvature, rejected = curvature / STEP_REDUCTION, rejected + 1
        if length < options.tolerance_mm or rejected == MAX_REJECTED:
            return Optimum(pose, here.cost, used, True)
    return Optimum(pose, here.cost, used, False)


def _bfgs(curvature: FloatArray, step: FloatArray, change: FloatArray) -> FloatArray:
    """BFGS update, damped where the cost is not convex along the step (Powell 1978).

    Args:
        change: of the gradient over the step.
    """
    pushed = curvature @ step
    expected = float(step @ pushed)
    if expected <= 0.0:
        return curvature
    along = float(step @ change)
    if along < MIN_CURVATURE_SHARE * expected:
        share = (1.0 - MIN_CURVATURE_SHARE) * expected / (expected - along)
        change = share * change + (1.0 - share) * pushed
        along = float(step @ change)
    return np.asarray(
        curvature - np.outer(pushed, pushed) / expected + np.outer(change, change) / along, dtype=np.float64
    )


def _first(
    metric: PoseMetric, pose: Rigid, center_mm: FloatArray, prior: PosePrior | None
) -> tuple[_Local, FloatArray]:
    """Cost and gradient, and the curvature (6, 6) to start from."""
    image = metric.normal_equations(pose, center_mm)
    curvature = image.matrix / image.slope.left / FIXED_FIT_STIFFNESS
    if prior is not None:
        curvature = curvature + prior.normal_equations(pose, center_mm)[0] / metric.information
    return _local(metric, image.slope, pose, center_mm, prior), curvature


def _local(
    metric: PoseMetric, image: Slope, pose: Rigid, center_mm: FloatArray, prior: PosePrior | None
) -> _Local:
    cost, gradient = 0.5 * math.log(max(1.0 - image.similarity, 1e-12)), -image.right / image.left
    if prior is None:
        return _Local(cost, gradient)
    share = 1.0 / metric.information
    touched = prior.normal_equations(pose, center_mm)[1]
    return _Local(cost + share * prior.energy(pose), gradient - share * touched)


@dataclass(frozen=True, slots=True, eq=False)
class GaussianPrior:
    """A pose with a standard deviation of PRIOR_SIGMA_MM in every coordinate, as a prior of `optimise`."""

    chart: PoseChart

    def energy(self, pose: Rigid) -> float:
        xi = self.chart.coordinates(pose)
        return float(0.5 * (xi @ xi) / PRIOR_SIGMA_MM**2)

    def normal_equations(self, pose: Rigid, center_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Small turns add: the Jacobian of ξ is taken as the identity, and the centre as the chart's."""
        return np.eye(6) / PRIOR_SIGMA_MM**2, -self.chart.coordinates(pose) / PRIOR_SIGMA_MM**2
