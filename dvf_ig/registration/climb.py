"""The search: over-relaxed Gauss–Newton on LC2, some ten steps where a search without derivatives needs 100.

Each step holds the local fits (`kernels.similarity_step`), solves for a small motion and holds them again.
Held fits make the step too short by a factor of two to eight, because α and β would have followed; so it is
stretched as long as that pays, and shortened when it does not. The gradient is exact: the end is a maximum.
"""

import math
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Rigid

from .chart import PoseChart
from .landmarks import LandmarkPrior
from .similarity import Lc2

DAMPING = 1e-3
FIRST_STRETCH, MOST_STRETCH, LEAST_STRETCH = 2.5, 8.0, 0.3
LONGER, SHORTER = 1.3, 0.4


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


@dataclass(frozen=True, slots=True, eq=False)
class _Local:
    """Cost and its quadratic model about a pose; `image` is to be divided by the stretch."""

    cost: float
    gradient: FloatArray
    image: FloatArray
    prior: FloatArray


def cost_of(metric: Lc2, pose: Rigid, prior: LandmarkPrior | None) -> float:
    """−log posterior per observation.

    With S the explained share of variance over n observations, −n/2·log(1 − S) is the log likelihood of the
    local linear model up to a constant; touched landmarks, if any, add their own.
    """
    image = 0.5 * math.log(max(1.0 - metric.score(pose).similarity, 1e-12))
    return image if prior is None else image + prior.energy(pose) / metric.information


def climb(
    metric: Lc2, start: Rigid, center_mm: FloatArray, prior: LandmarkPrior | None, options: ClimbOptions
) -> Climb:
    """Search from `start`.

    Args:
        center_mm: (3,) about which poses turn, fixed frame.
        prior: touched landmarks that the pose must also agree with.
    """
    pose, here = start, _local(metric, start, center_mm, prior)
    stretch, used = FIRST_STRETCH, 1
    while used < options.steps:
        curvature = here.image / stretch + here.prior
        damped = curvature + DAMPING * np.diag(np.diag(curvature)) + 1e-12 * np.eye(6)
        step = -np.linalg.solve(damped, here.gradient).astype(np.float64)
        length = float(np.linalg.norm(step))
        if length > options.cap_mm:
            step *= options.cap_mm / length
        tried = PoseChart(pose, center_mm).pose(step)
        there = _local(metric, tried, center_mm, prior)
        used += 1
        if there.cost < here.cost:
            pose, here = tried, there
            stretch = min(LONGER * stretch, MOST_STRETCH)
        else:
            stretch *= SHORTER
        if length < options.tolerance_mm or stretch < LEAST_STRETCH:
            return Climb(pose, here.cost, used, True)
    return Climb(pose, here.cost, used, False)


def _local(metric: Lc2, pose: Rigid, center_mm: FloatArray, prior: LandmarkPrior | None) -> _Local:
    image = metric.normal_equations(pose, center_mm)
    left = max(image.weight * (1.0 - image.similarity), 1e-12)
    cost = 0.5 * math.log(max(1.0 - image.similarity, 1e-12))
    gradient, curvature = -image.right / left, image.matrix / left
    if prior is None:
        return _Local(cost, gradient, curvature, np.zeros((6, 6)))
    touched = prior.normal_equations(pose, center_mm)
    share = 1.0 / metric.information
    return _Local(
        cost + share * prior.energy(pose), gradient - share * touched[1], curvature, share * touched[0]
    )
