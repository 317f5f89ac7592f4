"""Search for the pose: many starts optimised on coarse slices, the best distinct ones refined on fine slices.

Where the model's surface is known, the starts are many fits of the ultrasound's boundary to it, some
milliseconds each; elsewhere short optimisations of LC2 from displaced copies of the start.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dvf_ig.core import Rigid
from dvf_ig.registration.boundary.fit import Boundary, boundary_starts
from dvf_ig.registration.lc2.lc2 import Lc2
from dvf_ig.registration.lc2.optimise import OptimiserOptions, Optimum, optimise
from dvf_ig.registration.lc2.slices import SliceSet

from .images import Level, Problem
from .pose_chart import PoseChart, distinct, random_displacements

EXPLORATION = OptimiserOptions(steps=7, cap_mm=8.0, tolerance_mm=0.3)
"""Descents from displaced starts if the model's surface is not known."""
COARSE = OptimiserOptions(steps=16, cap_mm=6.0, tolerance_mm=0.2)
"""Descents of the candidates on coarse slices."""
FINE = OptimiserOptions(steps=30, cap_mm=2.0, tolerance_mm=0.01)
"""Descents of the candidates on fine slices."""
COVERED_ROUNDS = 2
"""Descents of a candidate where images end within the heart; each chooses again what is compared."""
WRONG_MM = 20.0
"""How far a pose is displaced that explains as much as chance does."""
BOUNDARY_STARTS, BOUNDARY_SPREAD_MM, BOUNDARY_KEPT = 24, 12.0, 3
"""Displaced copies of the start from which the boundary is fitted, how far they are displaced at the heart's
radius, and how many distinct ends are candidates."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Poses that lie apart, best first, and the evaluations of LC2 that they took."""

    poses: tuple[Rigid, ...]
    evaluations: int


def find_candidates(
    problem: Problem,
    metric: Lc2,
    start: Rigid,
    *,
    rng: np.random.Generator,
    report_progress: Callable[[float], None],
) -> Candidates:
    """Find the best distinct poses on coarse slices.

    Args:
        metric: LC2 on the coarse slices.
        rng: draws the displaced starts.
    """
    if problem.visible_boundary is not None:
        poses, evaluations = _boundary_fits(problem.visible_boundary, problem, start, rng), 0
    else:
        poses, evaluations = _displaced_optima(problem, metric, start, rng, report_progress)
    optima = _optima_on_coarse(problem, metric, poses, start)
    best = _best_distinct(optima, problem, problem.options.candidates)
    return Candidates(best, evaluations + sum(optimum.evaluations for optimum in optima))


def _boundary_fits(
    boundary: Boundary, problem: Problem, start: Rigid, rng: np.random.Generator
) -> tuple[Rigid, ...]:
    """Return the start, and the best distinct fits of the boundary from it and displaced copies of it."""
    fits = boundary_starts(
        boundary,
        start,
        problem.center_mm,
        rng=rng,
        count=BOUNDARY_STARTS if problem.options.starts else 0,
        spread_mm=BOUNDARY_SPREAD_MM,
        keep=BOUNDARY_KEPT,
    )
    return start, *(fit.pose for fit in fits)


def _displaced_optima(
    problem: Problem,
    metric: Lc2,
    start: Rigid,
    rng: np.random.Generator,
    report_progress: Callable[[float], None],
) -> tuple[tuple[Rigid, ...], int]:
    """Run short descents from displaced copies of the start; return the best distinct ends and the effort."""
    chart, options = PoseChart(start, problem.center_mm), problem.options
    displacements = random_displacements(rng, options.starts, options.spread_mm)
    optima: list[Optimum] = []
    for k, xi in enumerate(np.vstack([np.zeros(6), displacements])):
        optima.append(optimise(metric, chart.pose(xi), problem.center_mm, problem.prior, EXPLORATION))
        report_progress((k + 1) / (options.starts + 1))
    evaluations = sum(optimum.evaluations for optimum in optima)
    return _best_distinct(optima, problem, 2 * options.candidates), evaluations


def _optima_on_coarse(problem: Problem, metric: Lc2, poses: Sequence[Rigid], start: Rigid) -> list[Optimum]:
    """Optimise poses on coarse slices, on the covered part of the heart where its images end within it."""
    if problem.heart.covered is None:
        return [optimise(metric, pose, problem.center_mm, problem.prior, COARSE) for pose in poses]
    level = problem.images.coarse
    chance = _chance(problem, start)
    return [_covered_optimum(problem, problem.coarse_lc2, level, pose, COARSE, chance) for pose in poses]


def _covered_optimum(
    problem: Problem,
    metric_of: Callable[[SliceSet], Lc2],
    level: Level,
    start: Rigid,
    options: OptimiserOptions,
    chance: float,
) -> Optimum:
    """Optimise on what lies within the covered part, chosen again after each descent.

    The cost of its end is that of all slices, where those outside explain as much as chance does: a pose that
    leaves the covered part compares fewer observations and gains less.
    """
    end = Optimum(start, 0.0, 0, False)
    used = 0
    for _ in range(COVERED_ROUNDS):
        metric = metric_of(problem.compared(level, end.pose))
        end = optimise(metric, end.pose, problem.center_mm, problem.prior, options)
        used += end.evaluations
    metric = metric_of(problem.compared(level, end.pose))
    left = max(1.0 - metric.score(end.pose).similarity, 1e-12)
    cost = 0.5 * metric.information * math.log(left / (1.0 - chance))
    if problem.prior is not None:
        cost += problem.prior.energy(end.pose)
    return replace(end, cost=cost, evaluations=used)


def _chance(problem: Problem, start: Rigid) -> float:
    """Mean LC2 of the covered part at wrong poses, WRONG_MM from the start along and about every axis."""
    chart, level = PoseChart(start, problem.center_mm), problem.images.coarse
    scores = []
    for xi in WRONG_MM * np.eye(6):
        pose = chart.pose(xi)
        metric = problem.coarse_lc2(problem.compared(level, pose))
        if metric.information > 0.0:
            scores.append(metric.score(pose).similarity)
    return min(float(np.mean(scores)), 0.99) if scores else 0.0


def _best_distinct(optima: Sequence[Optimum], problem: Problem, count: int) -> tuple[Rigid, ...]:
    """Poses of the best optima that are not one another's neighbours, best first."""
    poses = [optimum.pose for optimum in sorted(optima, key=lambda optimum: optimum.cost)]
    return tuple(poses[k] for k in distinct(poses, problem.center_mm)[:count])


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """Refined candidates, and the metrics that they were refined by.

    Attributes:
        whole: LC2 on all fine slices.
        optima: of the candidates by `whole`, best first.
        inside: LC2 on the part of the fine slices within the model's volume at the best optimum.
        best: optimum by `inside`.
    """

    whole: Lc2
    optima: tuple[Optimum, ...]
    inside: Lc2
    best: Optimum

    @property
    def evaluations(self) -> int:
        return sum(optimum.evaluations for optimum in (*self.optima, self.best))


def refine(problem: Problem, candidates: Candidates, *, report_progress: Callable[[float], None]) -> Refined:
    """Optimise every candidate on fine slices, and the best once more within the model's volume."""
    whole, level = problem.fine_lc2(), problem.images.fine
    partly = problem.heart.covered is not None
    chance = _chance(problem, candidates.poses[0]) if partly else 0.0
    optima: list[Optimum] = []
    for k, pose in enumerate(candidates.poses):
        if partly:
            optima.append(_covered_optimum(problem, problem.fine_lc2, level, pose, FINE, chance))
        else:
            optima.append(optimise(whole, pose, problem.center_mm, problem.prior, FINE))
        report_progress((k + 1) / len(candidates.poses))
    optima.sort(key=lambda optimum: optimum.cost)
    inside = problem.fine_lc2(problem.inside_model(level, optima[0].pose))
    best = optimise(inside, optima[0].pose, problem.center_mm, problem.prior, FINE)
    return Refined(whole, tuple(optima), inside, best)
