"""The pose from LC2 and the boundary together, of a heart that may have changed its shape; its covariance."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dvf_ig.core import FloatArray, Rigid, read_only_arrays
from dvf_ig.registration.boundary.fit import BoundaryFit, fit_boundary
from dvf_ig.registration.evidence.covariance import covariance_mm2, placement_covariance_mm2
from dvf_ig.registration.lc2.lc2 import Lc2, SliceThreads
from dvf_ig.registration.lc2.slices import SliceSet, within
from dvf_ig.registration.search import Refined
from dvf_ig.registration.shape.blocks import BLOCK_MM, BlockedBoundary, BlockedLc2, BlockedMatch
from dvf_ig.registration.shape.fit import pose_and_shape

from .data import RegistrationData, RegistrationOptions
from .pose_chart import PoseChart, covariance_from_mm


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Fused:
    """The pose that LC2 and the boundary agree on, with its covariance.

    Attributes:
        pose: target_from_source.
        covariance: (6, 6) rad², mm²; NaN where the pose is no minimum.
        noise_covariance: (6, 6) likewise, of what independent patches would leave open.
        boundary: fit of the boundary from LC2's pose; None where the model's surface is not known or the
            slices show no boundary.
        covered: what of the coarse slices lies within the model's volume at LC2's pose.
        metric_of: LC2 of some of them.
    """

    pose: Rigid
    covariance: FloatArray
    noise_covariance: FloatArray
    boundary: BoundaryFit | None
    covered: SliceSet
    metric_of: Callable[[SliceSet], Lc2]


def fuse(
    data: RegistrationData, refined: Refined, options: RegistrationOptions, threads: SliceThreads
) -> Fused:
    """Go from LC2's pose to that which blocks of LC2 and of the boundary agree on best."""
    chart = PoseChart(refined.best.pose, data.center_mm)
    covered = within(data.coarse.slices, data.coarse.model.grid, chart.base)

    def metric_of(slices: SliceSet) -> Lc2:
        return replace(data.coarse, slices=slices).metric(options, threads)

    boundary = None
    if data.visible_boundary is not None:
        boundary = fit_boundary(data.visible_boundary, chart.base, data.center_mm)
    agreed = None
    if covered.masks.any():
        agreed = _agreed(data, _match(data, refined, boundary, options, chart), chart)
    if agreed is None:
        unknown = np.full((6, 6), np.nan)
        return Fused(chart.base, unknown, unknown, boundary, covered, metric_of)
    spread = agreed.covariance_mm2
    if data.placement is not None:
        spread = spread + placement_covariance_mm2(
            covered, metric_of, chart.base, data.center_mm, agreed.curvature, data.placement, data.rr_s
        )
    noise = np.asarray(np.linalg.inv(agreed.curvature))
    return Fused(
        agreed.pose, covariance_from_mm(spread), covariance_from_mm(noise), boundary, covered, metric_of
    )


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Agreed:
    """The pose that blocks agree on, its (6, 6) covariance, and the (6, 6) curvature of LC2 and landmarks."""

    pose: Rigid
    covariance_mm2: FloatArray
    curvature: FloatArray


def _agreed(data: RegistrationData, match: BlockedMatch, chart: PoseChart) -> _Agreed | None:
    """None where LC2 and landmarks are at no minimum."""
    curvature = match.curvature + _landmarks(data, chart)[0]
    if not _definite(curvature):
        return None
    found = pose_and_shape(match, chart, lambda here: _landmarks(data, here))
    return _Agreed(found.pose, covariance_mm2(found.first, found.influences), curvature)


def _match(
    data: RegistrationData,
    refined: Refined,
    boundary: BoundaryFit | None,
    options: RegistrationOptions,
    chart: PoseChart,
) -> BlockedMatch:
    seen, points = data.visible_boundary, None
    if seen is not None and boundary is not None:
        points = BlockedBoundary(seen, boundary.offset_mm, data.center_mm, block_mm=BLOCK_MM)
    information = refined.inside.information / options.times_seen
    return BlockedMatch(BlockedLc2(refined.inside, block_mm=BLOCK_MM), information, points, chart)


def _landmarks(data: RegistrationData, chart: PoseChart) -> tuple[FloatArray, FloatArray]:
    """(6, 6) curvature and (6,) gradient of what touched landmarks say of the pose."""
    if data.prior is None:
        return np.zeros((6, 6)), np.zeros(6)
    matrix, downhill = data.prior.normal_equations(chart.base, chart.center_mm)
    return matrix, -downhill


def _definite(matrix: FloatArray) -> bool:
    return bool(np.isfinite(matrix).all() and np.linalg.eigvalsh(matrix).min() > 0)
