"""Where ultrasound shows the tip of the tool, against where tracker and calibrations put it.

A tool of metal is a bright echo. Where the tracked tip lies in the image plane the image should be bright
there; with a wrong image calibration, tip or lag it is bright elsewhere. The heart's own bright edges are
there as well when the tip touches it, so images that pass beside the tip are what others are held against:

    a_b(q), c_b(q)   mean grey level, q mm from where the tip should be, over the images of beat b whose plane
                     the tip lies within IN_PLANE_MM of, or BESIDE_MM away from
    e(q) = mean over beats of a_b − mean over beats of c_b
    T = max e / SE                                                    one beat counts once

The tool is seen where max e and T are large: tissue has no such contrast between the two. Then the nearest
place that is nearly as bright as the brightest says how far off it is: a shaft that lies in the image is a
line that ends at the tip. What is off across the image, or towards the shaft along it, does not show.

Source: this project; Welch 1947 for SE, pooled over places.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from dvf_ig.core import AnyArray, BoolArray, FloatArray, ImageMap, read_only_arrays

PATCH_MM, STEP_MM = 10.0, 0.5
"""Half the edge of what is looked at around the tip, and its raster."""
IN_PLANE_MM = 1.5
"""How far the tip is at most from the plane of an image that should show it."""
BESIDE_MM = (5.0, 15.0)
"""How far it is from the plane of those that should not."""
SMOOTHING_MM = 1.0
"""Standard deviation of the Gaussian on the patches: the width of the echo."""
LEAST_INSIDE = 0.6
"""Share of a patch that must lie in the sector."""
LEAST_IN_PLANE, LEAST_BESIDE = 4, 3
"""Beats of both kinds, without which nothing is said."""
REMEMBERED_BEATS = 20
"""Of each kind: what is said is of the last half minute in which the tool was in view."""
SEEN_GREY, SEEN_RATIO = 60.0, 3.5
"""Least contrast in grey levels of 255, and over its standard error, of a tool that is seen. In 40 s of
tuning seeds 101–114 one that is not shown reaches 51 and 2.7 beside its place, 64 and 4.9 in it, where the
heart's edge lies; one that is shown 96 to 143 and 4.6 to 7.6, in poor images 60 to 79. With calibrations 6 mm
and 4° off it is 63 to 93 and 3.7 to 5.0 in three of five seeds, and not met in two."""
NEARLY = 0.7
"""Places of so much of the largest contrast belong to the tool."""
ELSEWHERE_MM = 3.0
"""A tool that is seen so far from where it should be speaks against the calibrations."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TipView:
    """Where the tip should be in one image.

    Attributes:
        pixel: (2,) column and row.
        beside_mm: distance from the image plane, signed.
    """

    pixel: FloatArray
    beside_mm: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TipPatches:
    """What the last beats showed around the tip.

    Attributes:
        in_plane, beside: (n, k, k) mean grey levels of a beat each, NaN outside the sector, oldest first.
    """

    in_plane: FloatArray
    beside: FloatArray

    @classmethod
    def none(cls) -> "TipPatches":
        """Of a session that has seen nothing."""
        size = len(_raster())
        return cls(np.empty((0, size, size)), np.empty((0, size, size)))

    def after(self, in_plane: Sequence[FloatArray], beside: Sequence[FloatArray]) -> "TipPatches":
        """With the patches (k, k) of one more beat's images, none or more of each kind."""
        return TipPatches(_with(self.in_plane, in_plane), _with(self.beside, beside))


@dataclass(frozen=True, slots=True)
class TipSighting:
    """A tool that is seen.

    Attributes:
        off_mm: from where the tip should be to the nearest place that belongs to the tool, in the image.
        contrast_grey: of the brightest place; ratio: to its standard error.
        beats: in which it is seen.
    """

    off_mm: float
    contrast_grey: float
    ratio: float
    beats: int

    @property
    def elsewhere(self) -> bool:
        """Whether it speaks against the calibrations."""
        return self.off_mm > ELSEWHERE_MM


def tip_view(tip_probe_mm: FloatArray, probe_from_image: ImageMap) -> TipView:
    """Where a tip (3,), frame of the probe's sensor, should be in its image."""
    rigid = probe_from_image.rigid
    x, y, z = (tip_probe_mm - rigid.translation_mm) @ rigid.rotation
    return TipView(np.array([x, y]) / probe_from_image.scale_mm_per_px, float(z))


def patch_around(
    image: AnyArray, sector: BoolArray, view: TipView, scale_mm_per_px: FloatArray
) -> FloatArray | None:
    """(k, k) grey levels around the tip, rows down the image, NaN outside the sector; None of too few.

    Args:
        image: (rows, columns) grey levels; sector: (rows, columns) pixels that were insonified.
    """
    offset = _raster()
    row, column = np.meshgrid(offset, offset, indexing="ij")
    at = np.stack([view.pixel[1] + row / scale_mm_per_px[1], view.pixel[0] + column / scale_mm_per_px[0]])
    inside = map_coordinates(sector.astype(np.float32), at, order=1, cval=0.0) > 0.99
    if inside.mean() < LEAST_INSIDE or not inside[len(offset) // 2, len(offset) // 2]:
        return None
    grey = map_coordinates(image.astype(np.float32), at, order=1, mode="nearest")
    return np.asarray(np.where(inside, grey, np.nan), dtype=np.float64)


def sighting(patches: TipPatches) -> TipSighting | None:
    """Where the tool is seen; None where it is not, or too few beats could have shown it."""
    seen, beside = patches.in_plane, patches.beside
    if len(seen) < LEAST_IN_PLANE or len(beside) < LEAST_BESIDE:
        return None
    known = np.isfinite(seen).all(axis=0) & np.isfinite(beside).all(axis=0)
    if not known.any():
        return None
    seen, beside = _smoothed(seen), _smoothed(beside)
    contrast = np.where(known, seen.mean(axis=0) - beside.mean(axis=0), -np.inf)
    variance = seen.var(axis=0, ddof=1) / len(seen) + beside.var(axis=0, ddof=1) / len(beside)
    largest = float(contrast.max())
    ratio = largest / max(float(np.sqrt(variance[known].mean())), 1e-12)
    if largest < SEEN_GREY or ratio < SEEN_RATIO:
        return None
    offset = _raster()
    away_mm = np.hypot(offset[:, None], offset)
    return TipSighting(float(away_mm[contrast >= NEARLY * largest].min()), largest, ratio, len(seen))


def _raster() -> FloatArray:
    return np.asarray(np.arange(-PATCH_MM, PATCH_MM + 0.5 * STEP_MM, STEP_MM))


def _with(before: FloatArray, images: Sequence[FloatArray]) -> FloatArray:
    """A pixel of a beat is known where all its images know it."""
    if not images:
        return before
    return np.concatenate([before, np.mean(images, axis=0)[None]])[-REMEMBERED_BEATS:]


def _smoothed(patches: FloatArray) -> FloatArray:
    """Places outside the sector count as the patch's mean."""
    level = np.nanmean(patches, axis=(1, 2), keepdims=True)
    filled = np.where(np.isfinite(patches), patches, level)
    return np.asarray(gaussian_filter(filled, (0.0, SMOOTHING_MM / STEP_MM, SMOOTHING_MM / STEP_MM)))
