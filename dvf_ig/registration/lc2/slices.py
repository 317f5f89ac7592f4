"""Ultrasound slices prepared for registration, from tracked frames and from volumes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import (
    BoolArray,
    FloatArray,
    Grid,
    ImageMap,
    IntArray,
    InvalidInputError,
    Rigid,
    TrackedVolume,
    read_only_arrays,
    require_same_frame,
)
from dvf_ig.kernels.grid.pool import pool_blocks, pool_cubes

CUBE_TOLERANCE = 1e-3
"""Relative difference of voxel edges up to which voxels count as cubes of one size."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SliceSet:
    """Slices at one pixel pitch that share one unknown pose.

    Attributes:
        frame: frame in which the slices lie, e.g. "tracker".
        images: (s, rows, columns) float32 brightness: of frames the grey levels as shown; 0 outside the mask.
        masks: (s, rows, columns), the insonified sector, eroded.
        frame_from_pixel: (s, 3, 3) mm from (column, row, 1) of this pitch.
        model_phase: (s,) where in the model's cycle each slice was seen, [0, 1).
        t_s: (s,) event times.
    """

    frame: str
    images: NDArray[np.float32]
    masks: BoolArray
    frame_from_pixel: FloatArray
    model_phase: FloatArray
    t_s: FloatArray

    def __len__(self) -> int:
        return len(self.images)

    def subset(self, index: IntArray) -> "SliceSet":
        return SliceSet(
            self.frame,
            self.images[index],
            self.masks[index],
            self.frame_from_pixel[index],
            self.model_phase[index],
            self.t_s[index],
        )


def within(slices: SliceSet, grid: Grid, pose: Rigid) -> SliceSet:
    """The slices without the pixels that lie outside an image at a pose: it says nothing of them."""
    rows, columns = slices.images.shape[1:]
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    pixels = np.stack([column, row, np.ones_like(row)], axis=-1).reshape(-1, 3).astype(np.float64)
    index_from_frame = np.linalg.inv(grid.axes_mm) @ pose.rotation
    offset = np.linalg.inv(grid.axes_mm) @ (pose.translation_mm - grid.origin_mm)
    masks = slices.masks.copy()
    for mask, frame_from_pixel in zip(masks, slices.frame_from_pixel, strict=True):
        index = pixels @ (index_from_frame @ frame_from_pixel).T + offset
        mask &= grid.holds(index).reshape(rows, columns)
    images = np.where(masks, slices.images, np.float32(0))
    return replace(slices, images=images, masks=masks)


def fan_mask_from_images(images: NDArray[np.uint8]) -> BoolArray:
    """(rows, columns) pixels ever above 0: the sector, where the scanner's geometry is not known."""
    return np.asarray(images.max(axis=0) > 0)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TrackedImages:
    """B-mode images of one tracked probe.

    Attributes:
        images: (s, rows, columns) grey levels.
        rotations, translations_mm: (s, 3, 3), (s, 3) tracker_from_probe at each image's event time.
        model_phase: (s,) where in the model's cycle each image was taken, [0, 1).
        t_s: (s,) event times.
    """

    images: NDArray[np.uint8]
    rotations: FloatArray
    translations_mm: FloatArray
    model_phase: FloatArray
    t_s: FloatArray


def prepare_slices(
    tracked: TrackedImages, mask: BoolArray, probe_from_image: ImageMap, *, pitch_mm: float
) -> SliceSet:
    """Average images down to `pitch_mm` and place them in the frame "tracker".

    Args:
        mask: (rows, columns) insonified sector.
        probe_from_image: calibration of the probe.
    Raises:
        InvalidInputError: nothing of the sector is left at this pitch.
    """
    step_c, step_r = (max(1, round(pitch_mm / s)) for s in probe_from_image.scale_mm_per_px)
    shares = _block_mean(mask.astype(np.float32)[None], step_r, step_c)[0]
    small_mask = shares > 0.999
    if not small_mask.any():
        raise InvalidInputError(f"no pixel of the ultrasound sector is left at a pitch of {pitch_mm:g} mm")
    small = np.stack([_block_mean(f[None].astype(np.float32), step_r, step_c)[0] for f in tracked.images])
    small[:, ~small_mask] = 0
    pixel = np.array(
        [[step_c, 0, (step_c - 1) / 2], [0, step_r, (step_r - 1) / 2], [0, 0, 0], [0, 0, 1]], dtype=np.float64
    )
    probe_from_pixel = (probe_from_image.matrix @ pixel)[:3]
    tracker_from_pixel = tracked.rotations @ probe_from_pixel
    tracker_from_pixel[:, :, 2] += tracked.translations_mm
    masks = np.broadcast_to(small_mask, small.shape).copy()
    return SliceSet(
        "tracker", small.astype(np.float32), masks, tracker_from_pixel, tracked.model_phase, tracked.t_s
    )


def _block_mean(images: NDArray[np.float32], step_r: int, step_c: int) -> NDArray[np.float32]:
    """Mean of every block of step_r × step_c pixels; summed by strides, six times faster than by axes."""
    rows, cols = images.shape[1] // step_r * step_r, images.shape[2] // step_c * step_c
    cut = images[:, :rows, :cols].reshape(len(images), rows // step_r, step_r, cols // step_c, step_c)
    across = cut[..., 0].copy()
    for k in range(1, step_c):
        across += cut[..., k]
    total = across[:, :, 0].copy()
    for k in range(1, step_r):
        total += across[:, :, k]
    return np.asarray(total / np.float32(step_r * step_c))


def slices_of_volume(
    values: NDArray[np.float32],
    axes_mm: FloatArray,
    origin_mm: FloatArray,
    *,
    every: int,
    frame: str,
    model_phase: float = 0.0,
    t_s: float = 0.0,
) -> SliceSet:
    """Planes of a 3-D ultrasound image along its three axes, padded to one size.

    Args:
        values: (nx, ny, nz) brightness; NaN where nothing was insonified.
        axes_mm: (3, 3) mm per voxel step; origin_mm: (3,).
        every: keep each `every`-th plane along each axis.
        model_phase, t_s: of the whole image.
    Raises:
        InvalidInputError: nothing was insonified.
    """
    size = max(values.shape)
    numbers = [np.arange(every // 2, n, every) for n in values.shape]
    stack = np.full((sum(map(len, numbers)), size, size), np.nan, dtype=np.float32)
    maps = np.empty((len(stack), 3, 3))
    end = 0
    for axis, chosen in enumerate(numbers):
        rows, columns = (a for a in range(3) if a != axis)
        part, end = slice(end, end + len(chosen)), end + len(chosen)
        cuts = values.transpose(axis, rows, columns)[chosen]
        stack[part, : cuts.shape[1], : cuts.shape[2]] = cuts
        maps[part, :, 0], maps[part, :, 1] = axes_mm[:, columns], axes_mm[:, rows]
        maps[part, :, 2] = origin_mm + chosen[:, None] * axes_mm[:, axis]
    masks = np.isfinite(stack)
    large = np.flatnonzero(np.count_nonzero(masks, axis=(1, 2)) >= 0.05 * size * size)
    if len(large) == 0:
        raise InvalidInputError("the ultrasound volume has no plane with enough insonified voxels")
    np.copyto(stack, np.float32(0), where=~masks)
    phases, times = np.full(len(stack), model_phase), np.full(len(stack), t_s)
    return SliceSet(frame, stack, masks, maps, phases, times).subset(large)


def joined(sets: Sequence[SliceSet]) -> SliceSet:
    """All slices of several sets in one frame, padded to one size."""
    rows, columns = (max(s.images.shape[axis] for s in sets) for axis in (1, 2))

    def padded(stack: NDArray[Any]) -> NDArray[Any]:
        if stack.shape[1:] == (rows, columns):
            return stack
        return np.pad(stack, ((0, 0), (0, rows - stack.shape[1]), (0, columns - stack.shape[2])))

    for other in sets[1:]:
        require_same_frame(sets[0].frame, other.frame, "slices that share one pose")
    return SliceSet(
        sets[0].frame,
        np.concatenate([padded(s.images) for s in sets]),
        np.concatenate([padded(s.masks) for s in sets]),
        np.concatenate([s.frame_from_pixel for s in sets]),
        np.concatenate([s.model_phase for s in sets]),
        np.concatenate([s.t_s for s in sets]),
    )


def prepare_volumes(volumes: Sequence[TrackedVolume], *, pitch_mm: float, planes: int) -> SliceSet:
    """Average grey levels, as shown, down to about `pitch_mm` and take planes of each along its three axes.

    Where all voxels are cubes of one size, the nearest whole number of them is averaged; others, and volumes
    that differ, are averaged over cubes of `pitch_mm`, each voxel by its share inside the cube.

    Args:
        volumes: of one transducer, at any number of phases; they share one unknown pose.
        planes: about this many along each axis.
    Raises:
        InvalidInputError: no volume, or nothing insonified.
    """
    if not volumes:
        raise InvalidInputError("no ultrasound volume passed the gate; needed at least one")
    edges = np.array([volume.image.grid.spacing_mm for volume in volumes])
    if np.ptp(edges) > CUBE_TOLERANCE * edges.max():
        return joined([_planes(volume, _cubes(volume, pitch_mm, planes)) for volume in volumes])
    return joined([_planes(volume, _blocks(volume, pitch_mm, planes)) for volume in volumes])


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Averaged:
    """Grey levels averaged over blocks of `edge` voxels, NaN where one of them was not insonified.

    Filled in on every `every`-th plane along each axis (`kernels.grid.pool.on_a_plane`).
    """

    values: NDArray[np.float32]
    edge: FloatArray
    every: int


def _blocks(volume: TrackedVolume, pitch_mm: float, planes: int) -> _Averaged:
    """Average over the nearest whole number of voxels, which are cubes."""
    grid = volume.image.grid
    step = max(1, round(pitch_mm / float(grid.spacing_mm[0])))
    small: NDArray[np.float32] = np.empty([n // step for n in grid.shape], dtype=np.float32)
    every = _every(small, planes)
    pool_blocks(volume.image.values, _insonified(volume), step, every, small)
    return _Averaged(small, np.full(3, float(step)), every)


def _cubes(volume: TrackedVolume, pitch_mm: float, planes: int) -> _Averaged:
    """Average over cubes of exactly `pitch_mm`."""
    grid = volume.image.grid
    edge = pitch_mm / grid.spacing_mm
    counts = [int(n / e + 1e-9) for n, e in zip(grid.shape, edge, strict=True)]  # 6 · 0.1 is 0.6
    small: NDArray[np.float32] = np.empty(counts, dtype=np.float32)
    every = _every(small, planes)
    pool_cubes(volume.image.values, _insonified(volume), edge, every, small)
    return _Averaged(small, edge, every)


def _every(small: NDArray[np.float32], planes: int) -> int:
    return max(1, int(max(small.shape)) // planes)


def _insonified(volume: TrackedVolume) -> NDArray[np.uint8]:
    """Convert a mask of any type to 8 bits; one of 8 bits is not copied."""
    values = volume.mask.values
    return values.view(np.uint8) if values.dtype.itemsize == 1 else np.asarray(values != 0, dtype=np.uint8)


def _planes(volume: TrackedVolume, averaged: _Averaged) -> SliceSet:
    grid, pose = volume.image.grid, volume.tracker_from_image
    return slices_of_volume(
        averaged.values,
        pose.rotation @ (grid.axes_mm * averaged.edge),
        pose.apply_array(grid.to_mm((averaged.edge - 1.0) / 2)),
        every=averaged.every,
        frame=pose.target,
        model_phase=volume.model_phase,
        t_s=volume.t_s,
    )


def subsample(count: int, most: int) -> IntArray:
    """Indices of at most `most` of `count` items, evenly spread, in order."""
    if count <= most:
        return np.arange(count, dtype=np.int64)
    return np.unique(np.round(np.linspace(0, count - 1, most)).astype(np.int64))
