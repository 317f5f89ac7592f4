"""Where ultrasound shows the tip of the tool, against where tracker and calibrations put it.

A tool of metal is a bright echo. Where the tracked tip lies in the image plane the image should be bright
there; with a wrong image calibration, tip or lag it is bright elsewhere, or in images whose plane should lie
beside the tip. The heart's own bright edges are there as well when the tip touches it, so images that pass
further beside are what others are held against:

    z              distance of the tip from the plane of an image
    g_b(q, z)      mean grey level, q mm from where the tip should be, over images of beat b with the tip at z
    e(q, z) = mean over beats of g_b(q, z) − mean over beats of g_b(q, z′), |z′ − z| in BESIDE_MM
    T(z) = max over q of e / SE                                       one beat counts once

The tool is seen where e and T are large: tissue has no such contrast between the two. The nearest place,
within the images and beside them, that is nearly as bright as the brightest says how far off it is: a shaft
is a line that ends at the tip. What is off along it towards the hand does not show.

Source: this project; Welch 1947 for SE, pooled over places.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from dvf_ig.core import AnyArray, BoolArray, FloatArray, ImageMap, IntArray, read_only_arrays

PATCH_MM, STEP_MM = 10.0, 0.5
"""Half the edge of what is looked at around the tip, and its raster."""
REACH_MM = 8.0
"""How far within an image the tip is looked for; beyond are other echoes as often as the tool's."""
PLANE_MM = 2.0
"""Images whose plane passes the tip alike to within half of this are taken together."""
SEARCHED_MM = 6.0
"""How far beside the plane that should hold the tip it is looked for."""
BESIDE_MM = (5.0, 15.0)
"""How far beside those pass that a plane is held against."""
SMOOTHING_MM = 1.0
"""Standard deviation of the Gaussian on the patches: the width of the echo."""
LEAST_INSIDE = 0.6
"""Share of a patch that must lie in the sector."""
LEAST_IN_PLANE, LEAST_BESIDE = 6, 3
"""Beats in a plane, and beside it, without which nothing is said of it. With four in the plane a shaft that
crosses one beside the tip is taken for it (poor images, tuning seed 101)."""
REMEMBERED_BEATS = 15
"""Beats remembered per plane."""
SEEN_GREY, SEEN_RATIO = 60.0, 3.5
"""Least contrast in grey levels of 255, and over its standard error, of a tool that is seen. In 40 s of
tuning seeds 101–115 one that is not shown reaches 42 and 2.7 beside its place; one that is shown 97 to 129
and 4.2 to 7.9, in poor images 58 to 100 and 5.7 to 9.4; with calibrations 6 mm and 4° off 94 to 119 and 4.7
to 7.3. Looked at as well: seeds 1, 2 and, with other limits, 301–320."""
BEAM_MM = 2.0
"""Half of a beam's thickness: so far beside its plane an image shows the tool as if within."""
NEARLY = 0.7
"""Places and planes of so much of the largest contrast belong to the tool."""
ELSEWHERE_MM = 3.0
"""Distance of the tool from where it should be that contradicts the calibrations."""
_RASTER_MM = np.arange(-PATCH_MM, PATCH_MM + 0.5 * STEP_MM, STEP_MM)
_AWAY_MM = np.hypot(_RASTER_MM[:, None], _RASTER_MM)
"""Rows, and columns, of a patch from its middle; and how far each of its places is from there."""


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

    @property
    def near(self) -> bool:
        """Whether the image takes part in the comparison."""
        return abs(self.beside_mm) <= SEARCHED_MM + BESIDE_MM[1]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TipPatches:
    """Images of the last beats around the tip, one row a beat and plane.

    Attributes:
        beat: (n,) running number; beside_mm: (n,) of the tip from the plane, in steps of PLANE_MM.
        grey: (n, k, k) smoothed grey levels, NaN outside the sector.
    """

    beat: IntArray
    beside_mm: FloatArray
    grey: FloatArray

    @classmethod
    def none(cls) -> "TipPatches":
        """Patches of a session that has seen nothing."""
        size = len(_RASTER_MM)
        return cls(np.empty(0, dtype=np.int64), np.empty(0), np.empty((0, size, size)))

    def after(self, images: Sequence[tuple[float, FloatArray]]) -> "TipPatches":
        """With one more beat.

        Args:
            images: at least one: how far the tip lies beside it, and its patch (k, k).
        """
        number = int(self.beat[-1]) + 1 if len(self.beat) else 0
        plane = PLANE_MM * np.round(np.array([beside_mm for beside_mm, _ in images]) / PLANE_MM)
        patches = np.stack([patch for _, patch in images])
        planes = np.unique(plane)
        grey = np.stack([_smoothed(patches[plane == one].mean(axis=0)) for one in planes])
        beat = np.append(self.beat, np.full(len(planes), number))
        beside_mm = np.append(self.beside_mm, planes)
        newer = (beside_mm[:, None] == beside_mm) & (beat[:, None] < beat)
        kept = newer.sum(axis=1) < REMEMBERED_BEATS
        return TipPatches(beat[kept], beside_mm[kept], np.concatenate([self.grey, grey])[kept])


@dataclass(frozen=True, slots=True)
class TipSighting:
    """A tool that is seen.

    Attributes:
        off_mm: from where the tip should be to the nearest place that belongs to the tool.
        beside_mm: how far beside the plane that should hold the tip it is seen, signed; `off_mm` counts what
            of it is beyond BEAM_MM.
        contrast_grey: of the brightest place; ratio: to its standard error.
        beats: in which it is seen.
    """

    off_mm: float
    beside_mm: float
    contrast_grey: float
    ratio: float
    beats: int

    @property
    def elsewhere(self) -> bool:
        """Whether it contradicts the calibrations."""
        return self.off_mm > ELSEWHERE_MM


def tip_view(tip_probe_mm: FloatArray, probe_from_image: ImageMap) -> TipView:
    """Where a tip (3,), frame of the probe's sensor, should be in its image."""
    rigid = probe_from_image.rigid
    x, y, z = (tip_probe_mm - rigid.translation_mm) @ rigid.rotation
    return TipView(np.array([x, y]) / probe_from_image.scale_mm_per_px, float(z))


def patch_around(
    image: AnyArray, sector: BoolArray, view: TipView, scale_mm_per_px: FloatArray
) -> FloatArray | None:
    """(k, k) grey levels around the tip, rows down the image, NaN outside the sector; None if too few.

    Args:
        image: (rows, columns) grey levels; sector: (rows, columns) pixels that were insonified.
    """
    rows = view.pixel[1] + _RASTER_MM / scale_mm_per_px[1]
    columns = view.pixel[0] + _RASTER_MM / scale_mm_per_px[0]
    part = tuple(
        slice(max(0, int(np.floor(at[0]))), max(0, int(np.ceil(at[-1])) + 1)) for at in (rows, columns)
    )
    seen, grey = sector[part].astype(np.float32), image[part].astype(np.float32)
    if not seen.any():
        return None
    at = np.stack(np.meshgrid(rows - part[0].start, columns - part[1].start, indexing="ij"))
    inside = map_coordinates(seen, at, order=1, cval=0.0) > 0.99
    if inside.mean() < LEAST_INSIDE or not inside[len(_RASTER_MM) // 2, len(_RASTER_MM) // 2]:
        return None
    return np.asarray(np.where(inside, map_coordinates(grey, at, order=1, mode="nearest"), np.nan))


def sighting(patches: TipPatches) -> TipSighting | None:
    """Locate the tool; None if it is not seen, or too few beats could have shown it."""
    planes = np.arange(-SEARCHED_MM, SEARCHED_MM + 0.5 * PLANE_MM, PLANE_MM)
    seen = [one for one in (_in_plane(patches, float(plane)) for plane in planes) if one is not None]
    brightest = max((one.contrast_grey for one in seen), default=0.0)
    if brightest < SEEN_GREY:
        return None
    nearest = min((one for one in seen if one.contrast_grey >= NEARLY * brightest), key=_distance)
    return nearest if nearest.ratio >= SEEN_RATIO else None


def _distance(seen: TipSighting) -> tuple[float, float]:
    return seen.off_mm, abs(seen.beside_mm)


def _in_plane(patches: TipPatches, plane_mm: float) -> TipSighting | None:
    """The brightest position in one plane; None for too few beats."""
    seen = patches.grey[patches.beside_mm == plane_mm]
    apart_mm = np.abs(patches.beside_mm - plane_mm)
    others = (apart_mm >= BESIDE_MM[0]) & (apart_mm <= BESIDE_MM[1])
    beats = np.unique(patches.beat[others])
    if len(seen) < LEAST_IN_PLANE or len(beats) < LEAST_BESIDE:
        return None
    beside = np.stack([patches.grey[others & (patches.beat == beat)].mean(axis=0) for beat in beats])
    known = np.isfinite(seen).all(axis=0) & np.isfinite(beside).all(axis=0)
    known &= _AWAY_MM <= REACH_MM
    if not known.any():
        return None
    contrast = np.where(known, seen.mean(axis=0) - beside.mean(axis=0), -np.inf)
    variance = seen.var(axis=0, ddof=1) / len(seen) + beside.var(axis=0, ddof=1) / len(beside)
    largest = float(contrast.max())
    if largest <= 0.0:
        return None
    within_mm = _AWAY_MM[contrast >= NEARLY * largest].min()
    beyond_mm = max(abs(plane_mm) - BEAM_MM, 0.0)
    return TipSighting(
        off_mm=float(np.hypot(within_mm, beyond_mm)),
        beside_mm=plane_mm,
        contrast_grey=largest,
        ratio=largest / max(float(np.sqrt(variance[known].mean())), 1e-12),
        beats=len(seen),
    )


def _smoothed(patch: FloatArray) -> FloatArray:
    """(k, k) by a Gaussian, to which places outside the sector count as the patch's mean; they stay NaN."""
    known = np.isfinite(patch)
    filled = np.where(known, patch, patch[known].mean() if known.any() else 0.0)
    return np.asarray(np.where(known, gaussian_filter(filled, SMOOTHING_MM / STEP_MM), np.nan))
