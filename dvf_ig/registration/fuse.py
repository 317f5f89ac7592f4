"""The pose of LC2 and the boundary together, of a heart that may have changed its shape; its covariance."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Rigid, read_only_arrays
from dvf_ig.registration.boundary.fit import Boundary, BoundaryFit, fit_boundary
from dvf_ig.registration.evidence.covariance import covariance_mm2, placement_covariance_mm2
from dvf_ig.registration.lc2.slices import SliceSet
from dvf_ig.registration.shape.blocks import (
    BLOCK_MM,
    LC2_INFORMATION,
    LC2_INFORMATION_OF_LABELS,
    BlockedBoundary,
    BlockedLc2,
    BlockedMatch,
)
from dvf_ig.registration.shape.fit import pose_and_shape

from .images import Problem
from .pose_chart import PoseChart, covariance_from_mm
from .search import Refined


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Fused:
    """The pose that LC2 and the boundary agree on, with its covariance.

    Attributes:
        pose: target_from_source.
        covariance: (6, 6) rad², mm²; NaN if the pose is no minimum.
        noise_covariance: (6, 6) likewise, of what independent patches would leave open.
        boundary: fit of the boundary from LC2's pose; None if the model's surface is not known or the
            slices show no boundary.
        covered: the part of the coarse slices within the model's volume, or the covered part, at LC2's pose.
        match: of LC2 and the boundary in blocks of space; None if the pose is no minimum.
    """

    pose: Rigid
    covariance: FloatArray
    noise_covariance: FloatArray
    boundary: BoundaryFit | None
    covered: SliceSet
    match: BlockedMatch | None


def fuse(problem: Problem, refined: Refined) -> Fused:
    """Go from LC2's pose to the one that blocks of LC2 and of the boundary agree on best."""
    chart, center_mm = PoseChart(refined.best.pose, problem.center_mm), problem.center_mm
    covered = problem.inside_model(problem.images.coarse, chart.base)
    seen = problem.boundary_at(chart.base)
    boundary = None if seen is None else fit_boundary(seen, chart.base, center_mm)
    match = (
        _match(problem, refined, seen, boundary, chart)
        if covered.masks.any() and len(refined.inside.patches.centers)
        else None
    )
    curvature = None if match is None else match.curvature + _landmarks(problem, chart)[0]
    if match is None or curvature is None or not _is_minimum(curvature):
        unknown = np.full((6, 6), np.nan)
        return Fused(chart.base, unknown, unknown, boundary, covered, None)
    fit = pose_and_shape(match, chart, lambda here: _landmarks(problem, here))
    spread = covariance_mm2(fit.first, fit.influences)
    if problem.images.placement is not None:
        spread = spread + placement_covariance_mm2(
            covered,
            problem.coarse_lc2,
            chart.base,
            center_mm,
            curvature,
            problem.images.placement,
            problem.images.rr_s,
        )
    noise = np.asarray(np.linalg.inv(curvature))
    return Fused(fit.pose, covariance_from_mm(spread), covariance_from_mm(noise), boundary, covered, match)


def _match(
    problem: Problem, refined: Refined, seen: Boundary | None, boundary: BoundaryFit | None, chart: PoseChart
) -> BlockedMatch:
    """LC2 and the boundary of every block of space."""
    points = None
    if seen is not None and boundary is not None:
        points = BlockedBoundary(seen, boundary.offset_mm, problem.center_mm, block_mm=BLOCK_MM)
    information = refined.inside.information / problem.options.times_seen
    covered = problem.heart.covered
    of_block = LC2_INFORMATION if covered is None or covered.views else LC2_INFORMATION_OF_LABELS
    return BlockedMatch(BlockedLc2(refined.inside, block_mm=BLOCK_MM), information, points, chart, of_block)


def _landmarks(problem: Problem, chart: PoseChart) -> tuple[FloatArray, FloatArray]:
    """(6, 6) curvature and (6,) gradient of the landmarks' −log likelihood."""
    if problem.prior is None:
        return np.zeros((6, 6)), np.zeros(6)
    matrix, downhill = problem.prior.normal_equations(chart.base, chart.center_mm)
    return matrix, -downhill


def _is_minimum(curvature: FloatArray) -> bool:
    return bool(np.isfinite(curvature).all() and np.linalg.eigvalsh(curvature).min() > 0)
