"""Fusion of LC2's pose with that of the boundary, and the covariance of both together."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dvf_ig.core import FloatArray, Rigid, read_only_arrays
from dvf_ig.registration.boundary.fit import BoundaryFit, fit_boundary
from dvf_ig.registration.evidence.covariance import (
    blocks_of,
    covariance_mm2,
    independent_covariance_mm2,
    placement_covariance_mm2,
)
from dvf_ig.registration.lc2.curvature import curvature_about
from dvf_ig.registration.lc2.lc2 import Lc2
from dvf_ig.registration.lc2.slices import SliceSet, within
from dvf_ig.registration.lc2.threads import SliceThreads

from .data import RegistrationData, RegistrationOptions
from .pose_chart import PoseChart, covariance_from_mm
from .refine import Refined


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Fused:
    """The pose fused from LC2 and the boundary, with its covariance.

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
    """Go a share of the way from LC2's pose to that of the boundary."""
    base = refined.best.pose
    chart = PoseChart(base, data.center_mm)
    covered = within(data.coarse.slices, data.coarse.model.grid, base)

    def metric_of(slices: SliceSet) -> Lc2:
        return replace(data.coarse, slices=slices).metric(options, threads)

    boundary, share, pose = None, 0.0, base
    if data.visible_boundary is not None:
        boundary = fit_boundary(data.visible_boundary, base, data.center_mm)
        share = options.boundary_share
        pose = chart.pose(share * chart.coordinates(boundary.pose))
    covariance = noise = np.full((6, 6), np.nan)
    curvature, landmarks = _curvature(data, refined, chart)
    determined = _definite(curvature) and (boundary is None or np.isfinite(boundary.covariance).all())
    if determined and covered.masks.any():
        noise = covariance_from_mm(independent_covariance_mm2(curvature, boundary, share))
        spread = covariance_mm2(
            blocks_of(covered, metric_of, base, data.center_mm),
            curvature,
            refined.inside.information,
            chart=chart,
            boundary=data.visible_boundary,
            fit=boundary,
            share=share,
            landmarks=landmarks,
        )
        if data.placement is not None:
            spread = spread + placement_covariance_mm2(
                covered, metric_of, base, data.center_mm, curvature, data.placement, data.rr_s
            )
        covariance = covariance_from_mm(spread)
    return Fused(pose, covariance, noise, boundary, covered, metric_of)


def _curvature(data: RegistrationData, refined: Refined, chart: PoseChart) -> tuple[FloatArray, FloatArray]:
    """(6, 6) curvature of −log posterior at LC2's pose, and of it what the landmarks give."""
    landmarks = np.zeros((6, 6))
    if data.prior is not None:
        landmarks = data.prior.normal_equations(chart.base, chart.center_mm)[0]
    image = curvature_about(refined.inside, chart).scaled(refined.inside.information)
    return image + landmarks, landmarks


def _definite(matrix: FloatArray) -> bool:
    return bool(np.isfinite(matrix).all() and np.linalg.eigvalsh(matrix).min() > 0)
