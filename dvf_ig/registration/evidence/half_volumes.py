"""Half-volumes registered on their own: deformation shows as disagreement between them and the whole."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dvf_ig.core import HEART_RADIUS_MM, FloatArray, Rigid, read_only_arrays
from dvf_ig.registration.lc2.slices import SliceSet

LEAST_SHARE = 0.1
"""A half with fewer of the pixels than this is left out."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class HalfVolume:
    """The slices of one half of space, to be registered on their own.

    Attributes:
        slices: what lies in one half of space.
        points_mm: (k, 3) source frame, where poses are compared.
        center_mm: (3,) target frame, about which its pose turns.
    """

    slices: SliceSet
    points_mm: FloatArray
    center_mm: FloatArray


def half_spaces(slices: SliceSet, pose: Rigid, center_mm: FloatArray) -> Iterator[HalfVolume]:
    """Both sides of the centre along each axis of the target frame, as far as they hold enough pixels."""
    corners = 0.5 * HEART_RADIUS_MM * np.vstack([np.eye(3), -np.eye(3)])
    source_from_target = pose.inverse()
    for axis in range(3):
        for sign in (1.0, -1.0):
            part = half_space(slices, pose, center_mm, axis, sign)
            if part.masks.sum() < LEAST_SHARE * slices.masks.sum():
                continue
            middle = center_mm + 0.5 * HEART_RADIUS_MM * sign * np.eye(3)[axis]
            yield HalfVolume(part, source_from_target.apply_array(middle + corners), center_mm)


def half_space(slices: SliceSet, pose: Rigid, center_mm: FloatArray, axis: int, sign: float) -> SliceSet:
    """The slices without the pixels that lie, at a pose, on the other side of the centre along an axis."""
    rows, columns = slices.images.shape[1:]
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    along = pose.rotation[axis] @ slices.frame_from_pixel
    place = along[:, 0, None, None] * column + along[:, 1, None, None] * row + along[:, 2, None, None]
    masks = slices.masks & (sign * (place + pose.translation_mm[axis] - center_mm[axis]) > 0)
    images = np.where(masks, slices.images, np.float32(0))
    return replace(slices, images=images, masks=masks).subset(np.flatnonzero(masks.any(axis=(1, 2))))
