"""Weights by the inverse density of patches: what many slices show counts as often as what few show.

Where the heart differs from its images it does so over centimetres, and every slice through a place repeats
that place's difference. Counted once a patch, the middle of a sweep, imaged from everywhere, would bias the
pose by its own difference; divided by how many patches lie about it, each place has the same influence.
"""

import numpy as np
from scipy import ndimage

from dvf_ig.core import FloatArray, IntArray

from .slices import SliceSet

LEAST_DENSITY = 0.3
"""Share of the median density below which a patch counts no more: a lone patch is not worth many."""


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
