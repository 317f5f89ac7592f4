"""Smooth depth of a labelled structure from thick slices: no stairs between them, closed beyond both ends."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import distance_transform_edt, gaussian_filter, label, map_coordinates

from dvf_ig.core import FloatArray, Grid, InvalidInputError, read_only_arrays

STEP_MM = 2.0
SMOOTHING_MM = 2.0
MARGIN_MM = 12.0
"""Step, smoothing and margin of the depth, in-plane; the margin is around the whole slice's labels."""


@dataclass(frozen=True, slots=True)
class Caps:
    """Extent of a structure beyond its last slices, and the flatness of its ends.

    Attributes:
        base_mm: extent beyond the basal slice.
        apex_widths: extent beyond the apical one, in half-widths of the structure there, plus `apex_mm`.
    """

    base_mm: float
    apex_widths: float
    apex_mm: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class StackDepth:
    """Depth of one structure, mm, positive inside, on a grid along the axes of the stack.

    Attributes:
        values_mm: (nx, ny, nz).
        grid: of `values_mm`, frame "mr".
    """

    values_mm: FloatArray
    grid: Grid

    def at(self, xyz_mm: FloatArray) -> FloatArray:
        """Interpolate (n,) depths at (n, 3) points linearly."""
        index = self.grid.to_index(xyz_mm).T
        return np.asarray(map_coordinates(self.values_mm, index, order=1, mode="nearest"))

    def gradient(self, xyz_mm: FloatArray) -> FloatArray:
        """Compute (n, 3) gradients at points by central differences over a node."""
        steps = STEP_MM * np.eye(3)
        columns = [(self.at(xyz_mm + e) - self.at(xyz_mm - e)) / (2 * STEP_MM) for e in steps]
        return np.stack(columns, axis=-1)


def stack_depth(mask: NDArray[np.bool_], grid: Grid, caps: Caps, *, base_first: bool) -> StackDepth:
    """Interpolate the structure between slices by its in-plane depth, and close it.

    Args:
        mask: (nx, ny, slices) voxels of the structure.
        grid: of the label image; slices along its last axis.
        base_first: slice 0 is the basal one.
    Raises:
        InvalidInputError: fewer than three slices hold the structure.
    """
    flat = _in_plane_depth(_largest(mask), grid)
    occupied = np.flatnonzero([np.isfinite(part).all() for part in np.moveaxis(flat, 2, 0)])
    if len(occupied) < 3:
        raise InvalidInputError(f"{len(occupied)} slices hold a structure; needed at least 3")
    pitch = float(grid.spacing_mm[2])
    slices_mm = pitch * occupied
    low, high = flat[:, :, occupied[0]], flat[:, :, occupied[-1]]
    ends = [_reach(low, caps, base_first), _reach(high, caps, not base_first)]
    z_mm = np.arange(slices_mm[0] - ends[0] - 8.0, slices_mm[-1] + ends[1] + 8.0, STEP_MM)
    inside = np.clip(z_mm, slices_mm[0], slices_mm[-1])
    values = np.asarray(PchipInterpolator(slices_mm, flat[:, :, occupied], axis=2)(inside))
    for k, z in enumerate(z_mm):
        if z < slices_mm[0]:
            values[:, :, k] = _capped(low, slices_mm[0] - z, ends[0], 4.0 if base_first else 2.0)
        elif z > slices_mm[-1]:
            values[:, :, k] = _capped(high, z - slices_mm[-1], ends[1], 2.0 if base_first else 4.0)
    spacing = np.array([grid.spacing_mm[0], grid.spacing_mm[1], STEP_MM])
    smooth = gaussian_filter(values, SMOOTHING_MM / spacing)
    origin = grid.to_mm(np.array([[0.0, 0.0, z_mm[0] / pitch]]))[0]
    return StackDepth(smooth, Grid("mr", smooth.shape, origin, spacing, grid.direction))


def _in_plane_depth(mask: NDArray[np.bool_], grid: Grid) -> FloatArray:
    """Compute signed distance within each slice; not finite in empty slices."""
    pixel = grid.spacing_mm[:2]
    out = np.full(mask.shape, np.nan)
    for k in np.flatnonzero(mask.any(axis=(0, 1))):
        inside = distance_transform_edt(mask[:, :, k], sampling=pixel)
        outside = distance_transform_edt(~mask[:, :, k], sampling=pixel)
        out[:, :, k] = inside - outside - 0.5 * pixel.mean() * np.sign(inside - outside)
    return out


def _largest(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the largest connected part."""
    parts, count = label(mask)
    if count <= 1:
        return mask
    return np.asarray(parts == 1 + int(np.argmax(np.bincount(parts.ravel())[1:])))


def _reach(end: FloatArray, caps: Caps, is_base: bool) -> float:
    return caps.base_mm if is_base else caps.apex_widths * float(end.max()) + caps.apex_mm


def _capped(end: FloatArray, beyond_mm: float, reach_mm: float, power: float) -> FloatArray:
    """Compute depth `beyond_mm` beyond a slice: a cap `reach_mm` high, ellipsoidal for power 2."""
    half = max(float(end.max()), 1.0)
    radius = np.maximum(1.0 - end / half, 0.0)
    level = (radius**power + (beyond_mm / reach_mm) ** power) ** (1.0 / power)
    return np.asarray(half * (1.0 - level))
