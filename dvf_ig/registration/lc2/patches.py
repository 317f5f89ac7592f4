"""What LC2 needs of ultrasound slices before any pose: runs of pixels, patches and their moments."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, IntArray, read_only_arrays
from dvf_ig.kernels.lc2.patches import window_moments
from dvf_ig.kernels.lc2.slices import CENTER_STEP

from .density_weights import inverse_density_weights, patch_centers_mm
from .slices import SliceSet

MIN_FILL = 0.6
"""Least share of a patch that must lie inside the sector."""
FLAT = 1e-12
"""Variance below which a patch of ultrasound carries nothing to explain."""


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
    """Square patches of all slices, and what of them depends on the ultrasound alone.

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
