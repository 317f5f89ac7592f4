"""Stacks of distant slices: the axes of an image along which motion can be observed."""

import numpy as np

from dvf_ig.core import AnyArray, BoolArray, FloatArray

SLICE_RATIO = 2.0
"""Elongation of voxels from which they form a stack of slices, between which motion is not observed."""

LOST_SPACING_RATIO = 2.5
"""Apparent over stated distance of neighbours along an axis from which the header has lost the slice pitch.
Short-axis cines of 10 mm slices written as 1 mm give 4.2 to 4.7, isotropic MR 1.3."""

MAX_LAG = 15


def observable_axes(spacing_mm: FloatArray) -> BoolArray:
    """Return (3,) axes of observable motion: all except the normal of a stack of distant slices.

    Between distant slices any displacement fits the interpolated grey levels, and the result folds.
    """
    return np.asarray(spacing_mm <= SLICE_RATIO * spacing_mm.min())


def axis_of_lost_spacing(grey: AnyArray, spacing_mm: FloatArray) -> int | None:
    """Find the axis whose voxels are further apart than the header says, or None.

    Compares how much grey levels differ between neighbours along each axis with how much they differ, along
    the two others, over increasing distances (the variogram of geostatistics). Noise is in both.

    Args:
        grey: (nx, ny, nz) one phase.
    """
    values = grey.astype(np.float64)
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        lags = np.arange(1, min(MAX_LAG, *(values.shape[a] - 1 for a in others)) + 1)
        if values.shape[axis] < 2 or len(lags) < 2:
            continue
        along = np.array([np.mean([_half_variance(values, a, int(n)) for a in others]) for n in lags])
        at_mm = lags * float(np.mean(spacing_mm[others]))
        alike_mm = np.interp(_half_variance(values, axis, 1), np.maximum.accumulate(along), at_mm)
        if alike_mm > LOST_SPACING_RATIO * max(spacing_mm[axis], spacing_mm[others].mean()):
            return axis
    return None


def _half_variance(values: FloatArray, axis: int, lag: int) -> float:
    """Compute half the mean squared difference of voxels `lag` apart along an axis."""
    rows = np.moveaxis(values, axis, 0)
    return 0.5 * float(np.mean((rows[lag:] - rows[:-lag]) ** 2))
