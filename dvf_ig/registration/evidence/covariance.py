"""Covariance of a registered pose: what varies from block to block, and what no block can see.

    C = S + MODEL_SHARE ((1 − s) H⁻¹ + s B)  +  H⁻¹ P H⁻¹  +  s² δδᵀ  +  C_placement  +  UNSEEN_MM² I

S = Σ ψψᵀ is the sandwich: ψ are the influences of blocks of space and of slices on the pose, which goes the
share s of the way from LC2's to the boundary's (`evidence.sandwich`). H⁻¹ and B are what independent
observations would leave of either: some tens of blocks tell how much a pose varies better than in which
direction. P is the information of touched landmarks, δ the disagreement of LC2 and the boundary, C_placement
what calibrations and clocks leave open (`placement`).
"""

from collections.abc import Callable

import numpy as np

from dvf_ig.core import FloatArray, Rigid
from dvf_ig.registration.boundary.fit import Boundary, BoundaryFit
from dvf_ig.registration.boundary.influence import boundary_influence
from dvf_ig.registration.lc2.blocks import BlockGradients, block_gradients
from dvf_ig.registration.lc2.lc2 import Lc2
from dvf_ig.registration.lc2.slices import SliceSet
from dvf_ig.registration.placement import (
    PlacementUncertainty,
    clock_covariance_mm2,
    image_covariance_mm2,
)
from dvf_ig.registration.pose_chart import PoseChart, covariance_to_mm

from .sandwich import BLOCK_MM, blended_influence, lc2_influence, sandwich

MODEL_SHARE, UNSEEN_MM = 0.5, 0.22
"""How much of the inverse curvatures counts, and the standard deviation per coordinate of what every block
shares: the rigid part of the difference between patient and pre-operative images, the bias of LC2. The
squared error by the covariance, 6 where it is right, is then 6.0 on average in calm and 5.1 in poor images:
tuning seeds 1001 and 1002 with 18 fields of mismatch of 1.2 to 3.2 mm. On 8 of them 0 and 0.39 give 5.7
and 6.5, 1 and 0.22 4.3 and 3.3."""


def blocks_of(
    slices: SliceSet, metric_of: Callable[[SliceSet], Lc2], pose: Rigid, center_mm: FloatArray
) -> BlockGradients:
    """LC2's gradient of every block of every slice; coarse slices do."""
    return block_gradients(metric_of(slices), pose, center_mm, block_mm=BLOCK_MM)


def covariance_mm2(
    blocks: BlockGradients,
    curvature: FloatArray,
    information: float,
    *,
    chart: PoseChart,
    boundary: Boundary | None,
    fit: BoundaryFit | None,
    share: float,
    landmarks: FloatArray,
) -> FloatArray:
    """(6, 6) without what the slices' placement adds, in the coordinates of `PoseChart`.

    Args:
        curvature: (6, 6) of −log posterior at LC2's pose, positive definite.
        information: number of observations in −n/2·log(1 − S).
        chart: of LC2's pose.
        share: of the way to the boundary's pose that the pose went; nought without a fit.
        landmarks: (6, 6) information of touched landmarks, nought without.
    """
    pulls = lc2_influence(blocks, information, curvature)
    cells, numbers = blocks.cell, blocks.slice
    if boundary is not None and fit is not None:
        place = np.floor(boundary.points.points_mm / BLOCK_MM).astype(np.int64)
        own_cells, group = np.unique(place, axis=0, return_inverse=True)
        pulls, cells, numbers = blended_influence(
            pulls,
            cells,
            numbers,
            boundary_influence(boundary, fit, chart.center_mm, group.ravel()),
            own_cells,
            share,
        )
    inverse = np.linalg.inv(curvature)
    away = np.zeros(6) if fit is None else share * chart.coordinates(fit.pose)
    return np.asarray(
        sandwich(pulls, cells, numbers)
        + MODEL_SHARE * independent_covariance_mm2(curvature, fit, share)
        + inverse @ landmarks @ inverse
        + np.outer(away, away)
        + UNSEEN_MM**2 * np.eye(6)
    )


def independent_covariance_mm2(curvature: FloatArray, fit: BoundaryFit | None, share: float) -> FloatArray:
    """(6, 6) what independent patches and points would leave open: (1 − s) H⁻¹ + s B, as `covariance_mm2`."""
    inverse = np.asarray(np.linalg.inv(curvature))
    return inverse if fit is None else (1.0 - share) * inverse + share * covariance_to_mm(fit.covariance)


def placement_covariance_mm2(
    slices: SliceSet,
    metric_of: Callable[[SliceSet], Lc2],
    pose: Rigid,
    center_mm: FloatArray,
    curvature: FloatArray,
    placement: PlacementUncertainty,
    rr_s: float | None,
) -> FloatArray:
    """(6, 6) that image calibration and clocks add.

    Args:
        rr_s: usual length of the beats; None where nothing beats.
    """
    weight = slices.masks.sum(axis=(1, 2)).astype(np.float64)
    added = image_covariance_mm2(slices, weight, pose, center_mm, placement)
    if rr_s is None:
        return added
    phase_sigma = placement.event_s / rr_s
    return added + clock_covariance_mm2(slices, metric_of, pose, center_mm, curvature, phase_sigma)
