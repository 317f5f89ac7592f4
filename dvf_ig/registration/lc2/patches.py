"""Pixels and patches of ultrasound slices, prepared for LC2 before any pose: moments, weights, parts.

Patches are weighted by the inverse of their density. Where the heart differs from its images it does so over
centimetres, and every slice through a position repeats its difference. Counted once a patch, the middle of a
sweep, imaged from everywhere, would bias the pose by its own difference; divided by how many patches lie
around it, each position has the same influence.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dvf_ig.core import FloatArray, IntArray, read_only_arrays
from dvf_ig.kernels.lc2.parts import SliceParts, window_moments
from dvf_ig.kernels.lc2.slices import (
    CENTER_STEP,
    FIRST,
    LAST,
    PATCH_COLUMN,
    PATCH_ROW,
    PIXEL,
    ROW,
    PatchedSlices,
)

from .slices import SliceSet

LEAST_DENSITY = 0.3
"""Share of the median density below which a patch counts no more: a lone patch is not worth many."""
MIN_FILL = 0.6
"""Least share of a patch that must lie inside the sector."""
FLAT = 1e-12
"""Variance below which a patch of ultrasound carries nothing to explain."""


def patch_centers_mm(slices: SliceSet, first: IntArray, centers: IntArray) -> FloatArray:
    """(p, 3) mm, centres of patches in the frame of the slices.

    Args:
        first, centers: see `patches.Patches`.
    """
    owner = np.repeat(np.arange(len(slices)), np.diff(first))
    pixel = np.column_stack([centers[:, 1], centers[:, 0], np.ones(len(centers))])
    return np.asarray(np.einsum("pij,pj->pi", slices.frame_from_pixel[owner], pixel))


def inverse_density_weights(places_mm: FloatArray, width_mm: float) -> FloatArray:
    """(n,) one over the density of (n, 3) places, 1 at the median density.

    Args:
        width_mm: full width, about, of the Gaussian that counts neighbours.
    """
    if len(places_mm) == 0:
        return np.zeros(0)
    cell = np.floor((places_mm - places_mm.min(axis=0)) / (width_mm / 2)).astype(np.int64)
    counts = np.zeros(cell.max(axis=0) + 1)
    np.add.at(counts, tuple(cell.T), 1.0)
    density = ndimage.gaussian_filter(counts, 1.0, mode="constant")[tuple(cell.T)]
    usual = float(np.median(density))
    return np.asarray(usual / np.maximum(density, LEAST_DENSITY * usual))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PixelRuns:
    """The pixels of all slices that lie in the sector.

    Attributes:
        first: (s + 1,) where each slice's runs begin.
        runs: (k, 4) row, first column, last column + 1, number of its first pixel.
        values: (n,) float32 ultrasound, run after run.
    """

    first: IntArray
    runs: IntArray
    values: NDArray[np.float32]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Square patches of all slices, with the part of LC2 that depends on the ultrasound alone.

    Attributes:
        first: (s + 1,) where each slice's patches begin.
        centers: (p, 2) row and column of the middle pixel.
        moments: (p, 4) one over the pixel count, mean and variance of the ultrasound, and weight: its
            standard deviation, over the density of patches where a width of density is given.
    """

    first: IntArray
    centers: IntArray
    moments: FloatArray


def pixel_runs(slices: SliceSet) -> PixelRuns:
    """The pixels inside the masks, row by row."""
    count, rows, columns = slices.masks.shape
    wide = columns + 1
    padded = np.zeros((count, rows, wide), dtype=np.bool_)
    padded[:, :, :columns] = slices.masks
    flat = padded.ravel()
    # a last column of False ends every row's last run
    edges = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    if flat[0]:
        edges = np.concatenate([[0], edges])
    begin, end = edges[::2], edges[1::2]
    row, column = np.divmod(begin, wide)
    pixel = np.cumsum(end - begin) - (end - begin)
    runs = np.column_stack([row % rows, column, column + end - begin, pixel])
    first = np.searchsorted(row, rows * np.arange(count + 1))
    return PixelRuns(first, runs, slices.images[slices.masks])


def patches_of(
    slices: SliceSet, pixels: PixelRuns, radius: int, density_width_mm: float | None = None
) -> Patches:
    """Patches of (2·radius + 1)² pixels, as far as they lie in the sector, not flat.

    Args:
        density_width_mm: width over which neighbours share weight (see `density_weights`); None: they do not.
    """
    slice_, row, column = np.nonzero(slices.masks[:, ::CENTER_STEP, ::CENTER_STEP])
    centers = CENTER_STEP * np.column_stack([row, column])
    numbers = np.arange(len(slices) + 1)
    out = np.empty((len(centers), 3))
    columns = np.empty((slices.masks.shape[2] + 2 * radius, 3))
    first = np.searchsorted(slice_, numbers)
    window_moments(pixels.values, pixels.first, pixels.runs, radius, first, centers, columns, out)
    count, mean, variance = out.T
    use = (count >= MIN_FILL * (2 * radius + 1) ** 2) & (variance > FLAT)
    first, centers, weight = np.searchsorted(slice_[use], numbers), centers[use], np.sqrt(variance[use])
    if density_width_mm is not None:
        weight *= inverse_density_weights(patch_centers_mm(slices, first, centers), density_width_mm)
    return Patches(first, centers, np.column_stack([1.0 / count[use], mean[use], variance[use], weight]))


def slice_parts(slices: PatchedSlices, owner: IntArray, part: IntArray) -> SliceParts:
    """Sort the patches of every slice by parts.

    Args:
        owner: (k,) of which slice each part is, ascending.
        part: (p,) which part each patch belongs to; none is empty.
    """
    order = np.argsort(part, kind="stable")
    first_patch = np.searchsorted(part[order], np.arange(len(owner) + 1))
    centers = np.ascontiguousarray(slices.centers[order])
    first_run, runs = _covered_runs(slices, owner, part[order], centers)
    moments = np.ascontiguousarray(slices.moments[order])
    for array in (first_run, runs, first_patch, centers, moments):
        array.setflags(write=False)  # as those of whole slices, so that kernels are compiled once for both
    cut = PatchedSlices(slices.pixels, first_run, runs, first_patch, centers, moments, slices.radius)
    first_part = np.searchsorted(owner, np.arange(len(slices.first_run)))
    return SliceParts(first_part, order - slices.first_patch[owner[part[order]]], cut)


def _covered_runs(
    slices: PatchedSlices, owner: IntArray, part: IntArray, centers: IntArray
) -> tuple[IntArray, IntArray]:
    """Where each part's runs begin, and runs (k, 4) from the first to the last column that its patches cover.

    Args:
        part: (p,) ascending; centers: (p, 2) of each part by rows.
    """
    radius = slices.radius
    rows = 1 + max(
        int(slices.runs[:, ROW].max(initial=0)), int(centers[:, PATCH_ROW].max(initial=0)) + radius
    )
    in_row = part * rows + centers[:, PATCH_ROW]
    begins = np.flatnonzero(np.diff(in_row, prepend=-1))
    ends = np.append(begins[1:], len(in_row)) - 1
    low = np.full(len(owner) * rows, np.iinfo(np.int64).max)
    high = np.full(len(owner) * rows, -1)
    for down in range(-radius, radius + 1):
        there = centers[begins, PATCH_ROW] + down >= 0
        at = in_row[begins[there]] + down
        low[at] = np.minimum(low[at], centers[begins[there], PATCH_COLUMN] - radius)
        high[at] = np.maximum(high[at], centers[ends[there], PATCH_COLUMN] + radius + 1)
    covered = np.flatnonzero(high >= 0)
    whose, row = np.divmod(covered, rows)
    run_row = np.repeat(np.arange(len(slices.first_run) - 1), np.diff(slices.first_run)) * rows
    run_row += slices.runs[:, ROW]
    first, last = (np.searchsorted(run_row, owner[whose] * rows + row, side) for side in ("left", "right"))
    # a row of a slice may have several runs
    count = last - first
    pair = np.repeat(np.arange(len(covered)), count)
    runs = slices.runs[np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count) + first[pair]]
    begin = np.maximum(runs[:, FIRST], low[covered[pair]])
    end = np.minimum(runs[:, LAST], high[covered[pair]])
    pixel = runs[:, PIXEL] + begin - runs[:, FIRST]
    nonempty = begin < end
    out = np.column_stack([row[pair], begin, end, pixel])[nonempty]
    return np.searchsorted(whose[pair][nonempty], np.arange(len(owner) + 1)), out
