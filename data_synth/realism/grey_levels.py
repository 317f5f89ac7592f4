"""Statistics of B-mode images as shown, to hold the synthetic worlds against recordings of scanners.

Grey levels are in percent of the highest level of a recording, so that recordings of other scanners compare.
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import ndimage

from dvf_ig.core import BoolArray, FloatArray

BORDER_MM = 4.0
"""The sector's border is left out: a scanner blends there."""
PATCH_MM = 6.0
"""Edge of the patches in which speckle is measured."""
EVEN_SHARE = 0.25
"""Share of the patches, the most even ones for their level, whose texture counts as speckle."""
BLACK, WHITE = 2.0, 98.0
"""Levels in % at or below and above which a pixel shows nothing: drop-out and shadow, saturation."""


@dataclass(frozen=True, slots=True)
class GreyLevels:
    """Statistics of one recording.

    Attributes:
        median, p95: grey level in the sector, %.
        black, white: share of the sector that shows nothing, %.
        contrast: between dark and bright patches, 10th to 90th percentile of their means, %.
        speckle: standard deviation of grey in even patches that show something, %.
        axial_mm, lateral_mm: distance away from the probe and across over which speckle's
            correlation falls to a half.
        depth_slope: change of the mean level with depth, % per cm.
        gain: standard deviation of the frames' mean levels, %.
    """

    median: float
    p95: float
    black: float
    white: float
    contrast: float
    speckle: float
    axial_mm: float
    lateral_mm: float
    depth_slope: float
    gain: float


def grey_levels(images: NDArray[np.uint8], mm_per_px: tuple[float, float]) -> GreyLevels:
    """Measure images (n, rows, columns) whose rows lead away from the probe.

    Args:
        mm_per_px: of rows and of columns.
    """
    level = 100.0 * images.astype(np.float64) / float(images.max())
    sector = _sector(images, mm_per_px)
    inside = level[:, sector]
    patches = _patches(level, sector, mm_per_px)
    means, deviations = patches.mean(axis=(1, 2)), patches.std(axis=(1, 2))
    shown = (means > 4 * BLACK) & (means < WHITE - 4 * BLACK)
    even = patches[shown & (deviations <= np.quantile(deviations[shown], EVEN_SHARE))]
    per_row = sector.sum(axis=1)
    rows = per_row > 0.05 * per_row.max()
    profile = (level.mean(axis=0) * sector).sum(axis=1)[rows] / per_row[rows]
    depth_cm = 0.1 * mm_per_px[0] * np.flatnonzero(rows)
    return GreyLevels(
        median=float(np.median(inside)),
        p95=float(np.quantile(inside, 0.95)),
        black=100.0 * float((inside <= BLACK).mean()),
        white=100.0 * float((inside >= WHITE).mean()),
        contrast=float(np.quantile(means, 0.9) - np.quantile(means, 0.1)),
        speckle=float(np.median(even.std(axis=(1, 2)))),
        axial_mm=mm_per_px[0] * _half_width(even),
        lateral_mm=mm_per_px[1] * _half_width(even.swapaxes(1, 2)),
        depth_slope=float(np.polyfit(depth_cm, profile, 1)[0]),
        gain=float(inside.mean(axis=1).std()),
    )


def _sector(images: NDArray[np.uint8], mm_per_px: tuple[float, float]) -> BoolArray:
    """Pixels that any image shows, without holes and without the border."""
    shown: BoolArray = np.any(images > 0, axis=0)
    seen = np.asarray(ndimage.binary_fill_holes(ndimage.binary_opening(shown)))
    depth_mm = ndimage.distance_transform_edt(np.pad(seen, 1), sampling=mm_per_px)[1:-1, 1:-1]
    return np.asarray(depth_mm > BORDER_MM)


def _patches(level: FloatArray, sector: BoolArray, mm_per_px: tuple[float, float]) -> FloatArray:
    """(m, high, wide) grey levels of the patches of all images that lie within the sector."""
    high, wide = (max(4, round(PATCH_MM / mm)) for mm in mm_per_px)
    views = sliding_window_view(level, (high, wide), axis=(1, 2))[:, ::high, ::wide]
    whole = sliding_window_view(sector, (high, wide))[::high, ::wide].all(axis=(2, 3))
    return np.asarray(views[:, whole].reshape(-1, high, wide))


def _half_width(patches: FloatArray) -> float:
    """Lag in pixels at which the correlation along axis 1 falls to a half, linearly interpolated."""
    texture = patches - patches.mean(axis=(1, 2), keepdims=True)
    power = float((texture * texture).mean())
    before = 1.0
    for lag in range(1, texture.shape[1]):
        now = float((texture[:, lag:] * texture[:, :-lag]).mean()) / power
        if now <= 0.5:
            return lag - 1 + (before - 0.5) / (before - now)
        before = now
    return float("nan")
