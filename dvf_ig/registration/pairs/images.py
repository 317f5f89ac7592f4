"""Parts of a pair of 3-D images that are registered: the eroded fan at one pitch, the anatomy around it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dvf_ig.core import (
    AnyArray,
    BoolArray,
    FloatArray,
    Grid,
    IntArray,
    InvalidInputError,
    Rigid,
    Volume,
    read_only_arrays,
)
from dvf_ig.kernels.grid.pool import pool_insonified
from dvf_ig.registration.lc2.volume_lc2 import VolumeChannels

EROSION_MM = 2.5
"""The outermost layer of the fan is left out: the scanner's blending there is no anatomy."""
GAP_MM = 2.0
"""Gaps up to twice this wide between non-zero voxels, which no frame reached, do not bound the fan."""
LEAST_SHARE = 0.25
"""Share of a block's voxels that must be non-zero."""
VOXELS_PER_PITCH = 1.25
"""Voxels of the anatomy a pitch of the ultrasound."""
POOLED_SHARE = 0.75
"""Voxels of the anatomy are averaged in whole blocks up to this share of a pitch before they are smoothed."""
SMOOTHING = 0.66
"""Standard deviation of the anatomy's smoothing in pitches."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class FanVolume:
    """A 3-D ultrasound image at one pitch.

    Attributes:
        grid: cut to the fan.
        values: (nx, ny, nz) float32 of unit variance, NaN where nothing was insonified.
    """

    grid: Grid
    values: NDArray[np.float32]

    @property
    def pitch_mm(self) -> float:
        return float(self.grid.spacing_mm.max())

    @property
    def insonified(self) -> BoolArray:
        return np.isfinite(self.values)

    def points_mm(self, count: int) -> FloatArray:
        """(about `count`, 3) insonified places in mm, evenly subsampled."""
        index = np.argwhere(self.insonified)
        return self.grid.to_mm(index[:: max(1, len(index) // count)].astype(np.float64))


def usable_voxels(ultrasound: Volume, mask: Volume | None) -> BoolArray:
    """Voxels of the ultrasound image that may be used.

    Raises:
        InvalidInputError: none, or a mask on another grid.
    """
    usable = np.isfinite(ultrasound.values) & (ultrasound.values != 0)
    if mask is not None:
        theirs, ours = mask.grid, ultrasound.grid
        if theirs.shape != ours.shape or not np.allclose(
            [theirs.to_mm(corner) for corner in _corners(theirs.shape)],
            [ours.to_mm(corner) for corner in _corners(ours.shape)],
            atol=0.1 * float(ours.spacing_mm.min()),
        ):
            raise InvalidInputError(
                f"the mask has shape {theirs.shape} at {_text(theirs.origin_mm)} mm, the fixed image "
                f"{ours.shape} at {_text(ours.origin_mm)} mm; resample the mask onto the fixed image's grid"
            )
        usable &= mask.values != 0
    if not usable.any():
        raise InvalidInputError("the fixed image has no non-zero voxel inside its mask")
    return np.asarray(usable)


def extent_mm(ultrasound: Volume, usable: BoolArray) -> float:
    """Longest edge of the box around what was insonified."""
    return float(
        max((s.stop - s.start) * h for s, h in zip(_box(usable), ultrasound.grid.spacing_mm, strict=True))
    )


def fan_volume(ultrasound: Volume, usable: BoolArray, pitch_mm: float) -> FanVolume:
    """The ultrasound averaged over blocks of about `pitch_mm`, the fan eroded.

    Gaps between frames are left out; dark regions that the fan encloses count as dark.

    Raises:
        InvalidInputError: nothing is left of the fan, or it has one value.
    """
    box = _wider(_box(usable), ultrasound.grid, EROSION_MM + pitch_mm)
    step = np.maximum(1, np.rint(pitch_mm / ultrasound.grid.spacing_mm)).astype(np.int64)
    step = np.minimum(step, [s.stop - s.start for s in box])
    shape = tuple((s.stop - s.start) // int(n) for s, n in zip(box, step, strict=True))
    level, share = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
    pool_insonified(
        np.array(ultrasound.values[box], dtype=np.float32), np.array(usable[box]), step, level, share
    )
    grid = Grid(
        ultrasound.grid.frame,
        (shape[0], shape[1], shape[2]),
        ultrasound.grid.to_mm(np.array([s.start for s in box]) + (step - 1) / 2),
        ultrasound.grid.spacing_mm * step,
        ultrasound.grid.direction,
    )
    seen = share > LEAST_SHARE
    closed = _closed(seen, grid.spacing_mm)
    whole = np.asarray(ndimage.binary_fill_holes(closed))
    dark = ndimage.binary_propagation(whole & ~closed, mask=whole & ~seen)
    fan = _eroded(whole, grid.spacing_mm) & (seen | dark)
    if not fan.any():
        raise InvalidInputError(
            f"nothing is left of the ultrasound fan at a pitch of {pitch_mm:g} mm after an erosion by "
            f"{EROSION_MM:g} mm; give a larger image or mask"
        )
    scale = float(level[fan].std())
    if not scale > 0:
        raise InvalidInputError(
            "the fixed image has one value throughout its fan; needed an ultrasound image"
        )
    return FanVolume(grid, np.where(fan, level / scale, np.nan).astype(np.float32))


def channels_around(
    anatomies: Sequence[Volume], fan: FanVolume, start: Rigid, reach_mm: float
) -> VolumeChannels:
    """Grey levels and gradient magnitude of every image on one grid around the fan, smoothed to its pitch.

    Args:
        anatomies: in one frame, on any grids; beyond an image its border value goes on.
        reach_mm: how far around the fan at its start pose.
    Raises:
        InvalidInputError: an image holds voxels that are no numbers, or one value only.
    """
    places = start.apply_array(fan.points_mm(5000))
    spacing_mm = fan.pitch_mm / VOXELS_PER_PITCH
    low = places.min(axis=0) - reach_mm
    count = np.ceil((places.max(axis=0) + reach_mm - low) / spacing_mm).astype(int) + 1
    shape = (int(count[0]), int(count[1]), int(count[2]))
    grid = Grid.axis_aligned(start.target, shape, low, spacing_mm)
    out = np.empty((*shape, 2 * len(anatomies)), dtype=np.float32)
    for k, image in enumerate(anatomies):
        level = _resampled(image, grid, SMOOTHING * fan.pitch_mm)
        squares = sum(np.square(np.gradient(level, spacing_mm, axis=axis)) for axis in range(3))
        for channel, values in enumerate((level, np.sqrt(squares))):
            out[..., 2 * k + channel] = (values - values.mean()) / max(float(values.std()), 1e-12)
    return VolumeChannels(grid, out)


def _resampled(image: Volume, grid: Grid, sigma_mm: float) -> NDArray[np.float32]:
    """The part of an image around a grid, smoothed and linearly interpolated there."""
    corners = np.stack(np.meshgrid(*([0, n - 1] for n in grid.shape), indexing="ij"), axis=-1).reshape(-1, 3)
    places = image.grid.to_index(grid.to_mm(corners.astype(np.float64)))
    top = np.array(image.grid.shape)
    margin = np.ceil(4 * sigma_mm / image.grid.spacing_mm) + 1
    low = np.clip(np.floor(places.min(axis=0) - margin), 0, top - 1).astype(int)
    high = np.clip(np.ceil(places.max(axis=0) + margin) + 1, low + 1, top).astype(int)
    part = image.values[low[0] : high[0], low[1] : high[1], low[2] : high[2]].astype(np.float32)
    if not np.isfinite(part).all():
        raise InvalidInputError(
            f"{int((~np.isfinite(part)).sum())} voxels of the moving image are no numbers; replace them, "
            "for instance by the background's value"
        )
    if part.min() == part.max():
        raise InvalidInputError("the moving image has one value around the ultrasound; needed anatomy")
    step = np.clip(np.floor(POOLED_SHARE * grid.spacing_mm / image.grid.spacing_mm), 1, part.shape).astype(
        int
    )
    part = _pooled(part, step)
    sigma = np.sqrt(np.square(sigma_mm / image.grid.spacing_mm) - (np.square(step) - 1) / 12.0) / step
    smooth = ndimage.gaussian_filter(part, sigma, mode="nearest", truncate=3.0)
    index_from_mm = np.linalg.inv(image.grid.axes_mm)
    offset = index_from_mm @ (grid.origin_mm - image.grid.origin_mm) - low
    matrix = index_from_mm @ grid.axes_mm / step[:, None]
    offset = (offset - (step - 1) / 2.0) / step
    return np.asarray(
        ndimage.affine_transform(smooth, matrix, offset, output_shape=grid.shape, order=1, mode="nearest")
    )


def _pooled(values: NDArray[np.float32], step: IntArray) -> NDArray[np.float32]:
    """Means of whole blocks of `step` voxels."""
    for axis, size in enumerate(step):
        if size > 1:
            values = np.moveaxis(values, axis, 0)
            count = len(values) // int(size)
            blocks = values[: count * int(size)].reshape(count, int(size), *values.shape[1:])
            values = np.moveaxis(blocks.mean(axis=1), 0, axis)
    return values


def share_inside(anatomies: Sequence[Volume], fan: FanVolume, pose: Rigid) -> float:
    """Share of the fan that lies inside the boxes of all images."""
    places = pose.apply_array(fan.points_mm(5000))
    inside = np.ones(len(places), dtype=bool)
    for image in anatomies:
        inside &= image.grid.holds(image.grid.to_index(places))
    return float(inside.mean())


def _closed(seen: BoolArray, spacing_mm: FloatArray) -> BoolArray:
    """The fan with its narrow gaps."""
    gap = max(1, round(GAP_MM / float(spacing_mm.max())))
    padded = np.pad(seen, gap)
    return np.asarray(ndimage.binary_closing(padded, iterations=gap)[gap:-gap, gap:-gap, gap:-gap]) | seen


def _eroded(fan: BoolArray, spacing_mm: FloatArray) -> BoolArray:
    """The fan without its outermost EROSION_MM; where the image's box cuts it off, it stays whole."""
    if fan.all():
        return fan
    return np.asarray(ndimage.distance_transform_edt(fan, sampling=spacing_mm) > EROSION_MM)


def _box(usable: BoolArray) -> tuple[slice, slice, slice]:
    flat: BoolArray = np.any(usable, axis=2)
    rows = (np.any(flat, axis=1), np.any(flat, axis=0), np.any(usable, axis=(0, 1)))
    ends = [np.flatnonzero(row)[[0, -1]] for row in rows]
    first, second, third = (slice(int(low), int(high) + 1) for low, high in ends)
    return first, second, third


def _wider(box: tuple[slice, slice, slice], grid: Grid, margin_mm: float) -> tuple[slice, slice, slice]:
    """The box with a margin, as far as the image goes: what the box cuts off is not eroded there."""
    more = np.ceil(margin_mm / grid.spacing_mm).astype(int)
    wide = [
        slice(max(0, s.start - m), min(n, s.stop + m)) for s, m, n in zip(box, more, grid.shape, strict=True)
    ]
    return wide[0], wide[1], wide[2]


def _corners(shape: tuple[int, int, int]) -> FloatArray:
    top = np.array(shape) - 1.0
    return np.vstack([np.zeros(3), np.diag(top), top])


def _text(xyz: AnyArray) -> str:
    return "(" + ", ".join(f"{v:.1f}" for v in xyz) + ")"
