"""Shape between the distant slices of a stack, by interpolating depth within the slices.

A mask of slices 10 mm apart, smoothed and cut at its half level, is a stair: at an apex the surface is off by
half of what the outline changes from slice to slice, and faces along the stack. The signed distance to the
outline within each slice changes smoothly instead (Raya and Udupa 1990).
"""

import numpy as np
from scipy import ndimage

from dvf_ig.core import BoolArray, FloatArray, Grid, IntArray

SMOOTHING_PIXELS, FINER = 1.0, 3
"""Standard deviation of the Gaussian on the mask within a slice, and how much finer its outline is found."""
END_POWER = 2.0
"""Beyond its last slice a structure closes over half a pitch like an ellipsoid (power 2)."""


def between_slices(mask: BoolArray, grid: Grid) -> tuple[BoolArray, Grid]:
    """Interpolate a mask to slices about as far apart as its pixels.

    Where the structure reaches the last slice of the image it goes on unchanged for half a pitch: the image
    ends there, not the structure.

    Args:
        mask: (nx, ny, nz), slices along the last axis.
        grid: of the mask.
    """
    pitch, pixel = float(grid.spacing_mm[2]), float(grid.spacing_mm[:2].mean())
    parts = max(1, 2 * round(0.5 * pitch / pixel))
    depth, occupied = depth_within_slices(mask, grid)
    # (count of fine slices) from half a pitch before the first occupied slice to half a pitch after the last
    first, last = int(occupied[0]), int(occupied[-1])
    count = (last - first + 1) * parts + 1
    height = first - 0.5 + np.arange(count) / parts
    fine = np.stack([_at(depth, occupied, z, grid.shape[2]) > 0.0 for z in height], axis=-1)
    origin = grid.to_mm(np.array([0.0, 0.0, height[0]]))
    spacing = np.array([grid.spacing_mm[0], grid.spacing_mm[1], pitch / parts])
    return fine, Grid(grid.frame, (grid.shape[0], grid.shape[1], count), origin, spacing, grid.direction)


def depth_within_slices(mask: BoolArray, grid: Grid) -> tuple[FloatArray, IntArray]:
    """(nx, ny, m) signed distance to the outline within each of m slices that hold one, positive inside.

    Returns:
        the depth, and the numbers of the slices.
    """
    occupied = np.flatnonzero(mask.any(axis=(0, 1)))
    return np.stack([_depth(mask[:, :, k], grid.spacing_mm[:2]) for k in occupied], axis=-1), occupied


def _depth(mask: BoolArray, pixel_mm: FloatArray) -> FloatArray:
    """Signed distance to the outline within a slice, positive inside.

    The outline is the half level of the smoothed mask, found on pixels FINER times as small: distances to the
    corners of pixels themselves are short by a part of a pixel.
    """
    soft = ndimage.gaussian_filter(mask.astype(np.float64), SMOOTHING_PIXELS)
    index = [(np.arange(FINER * n) + 0.5) / FINER - 0.5 for n in mask.shape]
    fine = ndimage.map_coordinates(soft, np.meshgrid(*index, indexing="ij"), order=1, mode="nearest") > 0.5
    sampling = pixel_mm / FINER
    inside = ndimage.distance_transform_edt(fine, sampling=sampling)
    outside = ndimage.distance_transform_edt(~fine, sampling=sampling)
    half = 0.5 * float(sampling.mean())
    depth = np.where(fine, inside - half, half - outside)
    return np.asarray(depth[FINER // 2 :: FINER, FINER // 2 :: FINER])


def _at(depth: FloatArray, occupied: IntArray, height: float, slices: int) -> FloatArray:
    """Depth at a height in slices: linear between slices, closed beyond the ends that the image shows."""
    first, last = float(occupied[0]), float(occupied[-1])
    if first <= height <= last:
        above = min(int(np.searchsorted(occupied, height)), len(occupied) - 1)
        below = max(above - 1, 0)
        span = float(occupied[above] - occupied[below])
        share = (height - float(occupied[below])) / span if span else 0.0
        return np.asarray((1.0 - share) * depth[..., below] + share * depth[..., above])
    end = 0 if height < first else len(occupied) - 1
    at_border = (first == 0) if end == 0 else (last == slices - 1)
    if at_border:
        return depth[..., end]
    beyond = 2.0 * (first - height if end == 0 else height - last)
    return np.asarray(depth[..., end] - float(depth[..., end].max()) * beyond**END_POWER)
