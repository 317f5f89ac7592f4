"""Planes through 3-D ultrasound, along its own axes, turned upright as radiologists view them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dvf_ig.core import AnyArray, BoolArray, FloatArray, Grid, Rigid, TrackedVolume, Volume
from dvf_ig.report.plane_marks import viewed_upright
from dvf_ig.report.plane_overlay import PlaneOverlay

from .planes import Anatomy, plane_overlay

PIXELS = 256
"""Approximate pixels along the longer edge of a plane; not finer than a third of a voxel."""
MOST_VOLUMES = 2
BRIGHT_PERCENT = 99.5
AXES = ("first", "second", "third")


def tracked_overlays(
    anatomy: Anatomy, volumes: Sequence[TrackedVolume], start: Rigid, registered: Rigid
) -> list[PlaneOverlay]:
    """Overlay three planes of each of up to MOST_VOLUMES volumes, evenly spread over those given.

    Args:
        start, registered: poses from the volumes' common frame.
    """
    chosen = sorted({round(i) for i in np.linspace(0, len(volumes) - 1, MOST_VOLUMES)})
    overlays = []
    for i in chosen:
        volume = volumes[i]
        pose = volume.tracker_from_image
        seen = volume.mask.values != 0
        overlays += _three_planes(
            anatomy,
            volume.image.grid,
            np.where(seen, volume.image.values, 0).astype(np.uint8),
            seen,
            start @ pose,
            registered @ pose,
            name=f"volume {i + 1}",
            event_s=volume.t_s or None,
            model_phase=volume.model_phase,
        )
    return overlays


def image_overlays(
    anatomy: Anatomy, ultrasound: Volume, start: Rigid, registered: Rigid
) -> list[PlaneOverlay]:
    """Overlay three planes of an ultrasound image of an organ that does not beat."""
    grey = shown_grey(ultrasound.values)
    return _three_planes(anatomy, ultrasound.grid, grey, grey > 0, start, registered, name="fixed image")


def shown_grey(values: AnyArray) -> NDArray[np.uint8]:
    """Scale grey levels to 0 to 255; 0 and NaN stay black."""
    usable = np.isfinite(values) & (values != 0)
    if not usable.any():
        return np.zeros(values.shape, dtype=np.uint8)
    low = min(0.0, float(values[usable].min()))
    high = float(np.percentile(values[usable], BRIGHT_PERCENT))
    level = 1.0 + 254.0 * (np.where(usable, values, low) - low) / max(high - low, 1e-12)
    return np.where(usable, np.clip(level, 1.0, 255.0), 0.0).astype(np.uint8)


def _three_planes(
    anatomy: Anatomy,
    grid: Grid,
    grey: NDArray[np.uint8],
    seen: BoolArray,
    start: Rigid,
    registered: Rigid,
    *,
    name: str,
    event_s: float | None = None,
    model_phase: float | None = None,
) -> list[PlaneOverlay]:
    """Cut planes across each axis of the grid, through the middle of the insonified part."""
    middle = ndimage.center_of_mass(seen) if seen.any() else (np.array(grid.shape) - 1.0) / 2
    overlays = []
    for axis in range(3):
        index_from_pixel = _upright(grid, axis, np.asarray(middle), registered.rotation)
        image, index_from_pixel = _resampled(grid, grey, index_from_pixel)
        frame_from_pixel = grid.axes_mm @ index_from_pixel
        frame_from_pixel[:, 2] += grid.origin_mm
        overlays.append(
            plane_overlay(
                anatomy,
                start,
                registered,
                image,
                frame_from_pixel,
                name=f"{name}, across its {AXES[axis]} axis",
                event_s=event_s,
                model_phase=model_phase,
            )
        )
    return overlays


def _upright(grid: Grid, axis: int, middle: FloatArray, rotation: FloatArray) -> FloatArray:
    """Compute (3, 3) voxel indices from (column, row, 1) counted in voxels, upright in the patient."""
    plane_axes = [a for a in range(3) if a != axis]
    column, row, left, up = viewed_upright((rotation @ grid.direction)[:, plane_axes].T)
    out = np.zeros((3, 3))
    out[axis, 2] = middle[axis]
    for k, (a, reversed_) in enumerate(((plane_axes[column], left), (plane_axes[row], up))):
        out[a, k] = -1.0 if reversed_ else 1.0
        out[a, 2] = grid.shape[a] - 1.0 if reversed_ else 0.0
    return out


def _resampled(
    grid: Grid, grey: NDArray[np.uint8], index_from_voxel: FloatArray
) -> tuple[NDArray[np.uint8], FloatArray]:
    """Resample the plane at square pixels; also return their map to voxel indices."""
    steps = [int(np.abs(index_from_voxel[:, k]).argmax()) for k in range(2)]
    mm = grid.spacing_mm[steps]
    count = np.array([grid.shape[a] for a in steps])
    pixel_mm = max(float((mm * (count - 1)).max()) / PIXELS, float(mm.min()) / 3)
    columns, rows = (np.floor((count - 1) * mm / pixel_mm).astype(int) + 1).tolist()
    index_from_pixel = index_from_voxel @ np.diag([pixel_mm / mm[0], pixel_mm / mm[1], 1.0])
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    pixels = np.stack([column.ravel(), row.ravel(), np.ones(column.size)])
    level = ndimage.map_coordinates(grey, index_from_pixel @ pixels, order=1, output=np.float64)
    return np.rint(level).reshape(rows, columns).astype(np.uint8), index_from_pixel
