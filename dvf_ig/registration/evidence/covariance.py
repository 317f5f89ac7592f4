"""Covariance of a registered pose: what blocks leave open, how they scatter, and what no block can see.

    C = S + Σ ψψᵀ + C_placement + UNSEEN_MM² I

S is what pose and change of shape leave of each other (`deformation.joint_fit`), ψ the influences of blocks
of space and of slices on that pose (`evidence.sandwich`), C_placement what calibrations and clocks leave open
(`placement`).
"""

from collections.abc import Callable

import numpy as np

from dvf_ig.core import FloatArray, Rigid
from dvf_ig.registration.deformation.blocks import Influences
from dvf_ig.registration.deformation.joint_fit import JointFit
from dvf_ig.registration.lc2.lc2 import Lc2
from dvf_ig.registration.lc2.slices import SliceSet
from dvf_ig.registration.placement import (
    PlacementUncertainty,
    clock_covariance_mm2,
    image_covariance_mm2,
)

from .sandwich import sandwich

UNSEEN_MM = 0.22
"""Standard deviation per coordinate of what every block shares: the bias of LC2."""


def covariance_mm2(fit: JointFit, influences: Influences) -> FloatArray:
    """(6, 6) without what the slices' placement adds, in the coordinates of `PoseChart`."""
    pulls = -np.einsum("gpu,gu->gp", fit.pull[influences.block], influences.gradient)
    scatter = sandwich(pulls, influences.block[:, None], influences.slice)
    return np.asarray(fit.covariance_mm2 + scatter + UNSEEN_MM**2 * np.eye(6))


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
