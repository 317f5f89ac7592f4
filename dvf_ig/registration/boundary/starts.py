"""Boundary fits from many starts: quick ones on few points, the best distinct ends on all of them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dvf_ig.core import FloatArray, Rigid
from dvf_ig.kernels.boundary import SHARE
from dvf_ig.registration.pose_chart import PoseChart, distinct, random_displacements

from .descent import descend, pose_of
from .fit import BoundaryFit, fit_at_end
from .options import BoundaryFitOptions
from .problem import Boundary, BoundaryProblem

QUICK_POINTS = 800
"""Of the first fits from many starts."""


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
