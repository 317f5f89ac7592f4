"""Where halves of space would rather have the pose: a bent heart fits in parts, but not as a whole."""

from dataclasses import replace

import numpy as np

from dvf_ig.core import FloatArray, Rigid
from dvf_ig.registration.lc2.channels import ModelChannels
from dvf_ig.registration.lc2.lc2 import Lc2
from dvf_ig.registration.lc2.optimise import ClimbOptions, climb
from dvf_ig.registration.lc2.slices import SliceSet
from dvf_ig.registration.pose_chart import HEART_RADIUS_MM

ALONE = ClimbOptions(steps=10, cap_mm=4.0, tolerance_mm=0.1)
LEAST_SHARE = 0.1
"""A half with fewer of the pixels than this is not asked."""


def part_disagreement_mm(
    slices: SliceSet,
    model: ModelChannels,
    pose: Rigid,
    center_mm: FloatArray,
    patch_mm: float,
    pitch_mm: float,
) -> float:
    """RMS over six half-spaces of the mean distance there between its own pose and that of all slices.

    Args:
        pose: near the optimum; all slices and each half climb from it.
        center_mm: (3,) where space is cut, across each axis of the fixed frame.
    Returns:
        mm; NaN where no half has enough to say.
    """
    whole = _alone(slices, model, pose, center_mm, patch_mm, pitch_mm)
    corners = 0.5 * HEART_RADIUS_MM * np.vstack([np.eye(3), -np.eye(3)])
    apart = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            part = half_space(slices, whole, center_mm, axis, sign)
            if part.masks.sum() < LEAST_SHARE * slices.masks.sum():
                continue
            own = _alone(part, model, whole, center_mm, patch_mm, pitch_mm)
            middle = center_mm + 0.5 * HEART_RADIUS_MM * sign * np.eye(3)[axis]
            points = whole.inverse().apply_array(middle + corners)
            apart.append(np.linalg.norm(own.apply_array(points) - whole.apply_array(points), axis=1).mean())
    return float(np.sqrt(np.mean(np.square(apart)))) if apart else float("nan")


def half_space(slices: SliceSet, pose: Rigid, center_mm: FloatArray, axis: int, sign: float) -> SliceSet:
    """The slices without the pixels that lie, at a pose, on the other side of the centre along an axis."""
    rows, columns = slices.images.shape[1:]
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    along = pose.rotation[axis] @ slices.frame_from_pixel
    place = along[:, 0, None, None] * column + along[:, 1, None, None] * row + along[:, 2, None, None]
    masks = slices.masks & (sign * (place + pose.translation_mm[axis] - center_mm[axis]) > 0)
    images = np.where(masks, slices.images, np.float32(0))
    return replace(slices, images=images, masks=masks).subset(np.flatnonzero(masks.any(axis=(1, 2))))


def _alone(
    slices: SliceSet,
    model: ModelChannels,
    pose: Rigid,
    center_mm: FloatArray,
    patch_mm: float,
    pitch_mm: float,
) -> Rigid:
    metric = Lc2(slices, model, patch_mm=patch_mm, pitch_mm=pitch_mm)
    return climb(metric, pose, center_mm, None, ALONE).pose
