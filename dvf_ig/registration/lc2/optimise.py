"""The search: quasi-Newton on LC2, some ten steps where a search without derivatives needs 100.

The gradient is exact (`kernels.similarity_step`). The curvature starts as that of Gauss–Newton with the local
fits held, divided by HELD_STIFFNESS: held fits make a valley look that much narrower, because α and β would
have followed. From then on it learns from how the gradient changes (BFGS).
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dvf_ig.core import FloatArray, Rigid, read_only_arrays
from dvf_ig.registration.pose_chart import PoseChart

from .lc2 import Lc2

DAMPING = 1e-3
HELD_STIFFNESS = 6.0
"""Gauss–Newton's eigenvalues over the true ones: 8 to 12 at the optimum (tuning seeds 102, 106), less away
from it."""
SHORTER = 0.3
LEAST_CURVED = 0.05
"""A learnt curvature is at least this share of the step's own."""
GIVE_UP = 8
"""Steps in a row that made it worse."""


class PosePrior(Protocol):
    """What is known of a pose besides the image, as −log of its likelihood (see `LandmarkPrior`)."""

    def energy(self, pose: Rigid) -> float: ...

    def normal_equations(self, pose: Rigid, center_mm: FloatArray) -> tuple[FloatArray, FloatArray]: ...


@dataclass(frozen=True, slots=True)
class ClimbOptions:
    """Attributes:
    steps: most evaluations.
    cap_mm: longest step.
    tolerance_mm: a step shorter than this ends the search.
    """

    steps: int
    cap_mm: float
    tolerance_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Climb:
    """Where a search ended: pose, cost (see `cost_of`), evaluations, and whether it came to rest."""

    pose: Rigid
    cost: float
    evaluations: int
    converged: bool


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Local:
    """Cost, its gradient (6,), and the curvature (6, 6) to start from."""

    cost: float
    gradient: FloatArray
    curvature: FloatArray


def cost_of(metric: Lc2, pose: Rigid, prior: PosePrior | None) -> float:
    """−log posterior per observation.

    With S the explained share of variance over n observations, −n/2·log(1 − S) is the log likelihood of the
    local linear model up to a constant; touched landmarks, if any, add their own.
    """
    image = 0.5 * math.log(max(1.0 - metric.score(pose).similarity, 1e-12))
    return image if prior is None else image + prior.energy(pose) / metric.information


def climb(
    metric: Lc2, start: Rigid, center_mm: FloatArray, prior: PosePrior | None, options: ClimbOptions
) -> Climb:
    """Search from `start`.

    Args:
        center_mm: (3,) about which poses turn, fixed frame.
        prior: what the pose must also agree with, as touched landmarks.
    """
    pose, here = start, _local(metric, start, center_mm, prior)
    curvature, used, worse = here.curvature, 1, 0
    while used < options.steps:
        damped = curvature + DAMPING * np.diag(np.diag(curvature)) + 1e-12 * np.eye(6)
        step = -np.linalg.solve(damped, here.gradient).astype(np.float64)
        length = float(np.linalg.norm(step))
        step *= min(1.0, options.cap_mm / max(length, 1e-12))
        tried = PoseChart(pose, center_mm).pose(step)
        there = _local(metric, tried, center_mm, prior)
        used += 1
        curvature = _learnt(curvature, step, there.gradient - here.gradient)
        if there.cost < here.cost:
            pose, here, worse = tried, there, 0
        else:
            curvature, worse = curvature / SHORTER, worse + 1
        if length < options.tolerance_mm or worse == GIVE_UP:
            return Climb(pose, here.cost, used, True)
    return Climb(pose, here.cost, used, False)


def _learnt(curvature: FloatArray, step: FloatArray, change: FloatArray) -> FloatArray:
    """BFGS, damped where the cost is not convex along the step (Powell 1978)."""
    pushed = curvature @ step
    expected = float(step @ pushed)
    if expected <= 0.0:
        return curvature
    along = float(step @ change)
    if along < LEAST_CURVED * expected:
        share = (1.0 - LEAST_CURVED) * expected / (expected - along)
        change = share * change + (1.0 - share) * pushed
        along = float(step @ change)
    return np.asarray(
        curvature - np.outer(pushed, pushed) / expected + np.outer(change, change) / along, dtype=np.float64
    )


def _local(metric: Lc2, pose: Rigid, center_mm: FloatArray, prior: PosePrior | None) -> _Local:
    image = metric.normal_equations(pose, center_mm)
    left = max(image.weight * (1.0 - image.similarity), 1e-12)
    cost = 0.5 * math.log(max(1.0 - image.similarity, 1e-12))
    gradient, curvature = -image.right / left, image.matrix / left / HELD_STIFFNESS
    if prior is None:
        return _Local(cost, gradient, curvature)
    touched = prior.normal_equations(pose, center_mm)
    share = 1.0 / metric.information
    return _Local(
        cost + share * prior.energy(pose), gradient - share * touched[1], curvature + share * touched[0]
    )
