"""Search for the pose: many starts optimised on coarse slices, the best distinct ones refined on fine slices.

Where the model's surface is known, the starts are many fits of the ultrasound's boundary to it, some
milliseconds each; elsewhere short optimisations of LC2 from displaced copies of the start.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dvf_ig.core import Rigid
from dvf_ig.registration.boundary.fit import Boundary, boundary_starts
from dvf_ig.registration.data import RegistrationData, RegistrationOptions
from dvf_ig.registration.lc2.lc2 import Lc2, SliceThreads
from dvf_ig.registration.lc2.optimise import OptimiserOptions, Optimum, optimise
from dvf_ig.registration.lc2.slices import within
from dvf_ig.registration.pose_chart import PoseChart, distinct, random_displacements

EXPLORATION = OptimiserOptions(steps=7, cap_mm=8.0, tolerance_mm=0.3)
"""From displaced starts, where the model's surface is not known:"""
COARSE = OptimiserOptions(steps=16, cap_mm=6.0, tolerance_mm=0.2)
"""Of the candidates on coarse slices:"""
BOUNDARY_STARTS, BOUNDARY_SPREAD_MM, BOUNDARY_KEPT = 24, 12.0, 3
"""Displaced copies of the start from which the boundary is fitted, how far they are displaced at the heart's
radius, and how many distinct ends are candidates."""
FINE = OptimiserOptions(steps=30, cap_mm=2.0, tolerance_mm=0.01)
"""Of the candidates on fine slices:"""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Poses that lie apart, best first, and the evaluations of LC2 that they took."""

    poses: tuple[Rigid, ...]
    evaluations: int


def find_candidates(
    data: RegistrationData,
    metric: Lc2,
    start: Rigid,
    *,
    rng: np.random.Generator,
    options: RegistrationOptions,
    report_progress: Callable[[float], None],
) -> Candidates:
    """The best distinct poses on coarse slices.

    Args:
        metric: LC2 on the coarse slices.
        rng: draws the displaced starts.
    """
    if data.visible_boundary is not None:
        poses, evaluations = _boundary_fits(data.visible_boundary, data, start, rng, options), 0
    else:
        poses, evaluations = _displaced_optima(data, metric, start, rng, options, report_progress)
    optima = [optimise(metric, pose, data.center_mm, data.prior, COARSE) for pose in poses]
    best = _best_distinct(optima, data, options.candidates)
    return Candidates(best, evaluations + sum(optimum.evaluations for optimum in optima))


def _boundary_fits(
    boundary: Boundary,
    data: RegistrationData,
    start: Rigid,
    rng: np.random.Generator,
    options: RegistrationOptions,
) -> tuple[Rigid, ...]:
    """The start, and the best distinct fits of the boundary from it and displaced copies of it."""
    fits = boundary_starts(
        boundary,
        start,
        data.center_mm,
        rng=rng,
        count=BOUNDARY_STARTS if options.starts else 0,
        spread_mm=BOUNDARY_SPREAD_MM,
        keep=BOUNDARY_KEPT,
    )
    return start, *(fit.pose for fit in fits)


def _displaced_optima(
    data: RegistrationData,
    metric: Lc2,
    start: Rigid,
    rng: np.random.Generator,
    options: RegistrationOptions,
    report_progress: Callable[[float], None],
) -> tuple[tuple[Rigid, ...], int]:
    """The best distinct ends of short optimisations from the start and displaced copies; evaluations."""
    chart = PoseChart(start, data.center_mm)
    displacements = random_displacements(rng, options.starts, options.spread_mm)
    optima: list[Optimum] = []
    for k, xi in enumerate(np.vstack([np.zeros(6), displacements])):
        optima.append(optimise(metric, chart.pose(xi), data.center_mm, data.prior, EXPLORATION))
        report_progress((k + 1) / (options.starts + 1))
    evaluations = sum(optimum.evaluations for optimum in optima)
    return _best_distinct(optima, data, 2 * options.candidates), evaluations


def _best_distinct(optima: Sequence[Optimum], data: RegistrationData, count: int) -> tuple[Rigid, ...]:
    """Poses of the best optima that are not one another's neighbours, best first."""
    poses = [optimum.pose for optimum in sorted(optima, key=lambda optimum: optimum.cost)]
    return tuple(poses[k] for k in distinct(poses, data.center_mm)[:count])


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """Refined candidates, and the metrics that they were refined by.

    Attributes:
        whole: LC2 on all fine slices.
        optima: of the candidates by `whole`, best first.
        inside: LC2 on what of the fine slices lies within the model's volume at the best optimum.
        best: optimum by `inside`.
    """

    whole: Lc2
    optima: tuple[Optimum, ...]
    inside: Lc2
    best: Optimum

    @property
    def evaluations(self) -> int:
        return sum(optimum.evaluations for optimum in (*self.optima, self.best))


def refine(
    data: RegistrationData,
    candidates: Candidates,
    *,
    options: RegistrationOptions,
    threads: SliceThreads,
    report_progress: Callable[[float], None],
) -> Refined:
    """Optimise every candidate on fine slices, and rank them by their cost there."""
    whole = data.fine.metric(options, threads)
    optima: list[Optimum] = []
    for k, pose in enumerate(candidates.poses):
        optima.append(optimise(whole, pose, data.center_mm, data.prior, FINE))
        report_progress((k + 1) / len(candidates.poses))
    optima.sort(key=lambda optimum: optimum.cost)
    covered = within(data.fine.slices, data.fine.model.grid, optima[0].pose)
    inside = replace(data.fine, slices=covered).metric(options, threads)
    best = optimise(inside, optima[0].pose, data.center_mm, data.prior, FINE)
    return Refined(whole, tuple(optima), inside, best)
