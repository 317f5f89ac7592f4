"""Does speckle go where the tissue goes? Block matching between two simulated frames."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, Rigid

from .realism import STANDARD, Gate
from .realism_media import medium
from .tissue import Tissue
from .ultrasound import simulate_frame
from .ultrasound_probe import SectorProbe

BLOCK_MM, SEARCH_MM = 12.0, 4.0
AXIAL_MM, LATERAL_MM = 0.15, 0.3
"""Bounds of the median errors: a third of the pulse, a sixth of the beam at the focus."""


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Blocks followed from one image to the next, plane frame, mm.

    Attributes:
        places: (n, 2) lateral and depth of the blocks' centres in the first image.
        moved: (n, 2) measured displacement.
        score: (n,) correlation at the best place.
    """

    places: FloatArray
    moved: FloatArray
    score: FloatArray


def match_blocks(
    first: NDArray[np.uint8], second: NDArray[np.uint8], probe: SectorProbe, places_mm: FloatArray
) -> Match:
    """Find the blocks around `places_mm` (n, 2) of the first image in the second one.

    Normalised correlation over whole pixels, refined by a parabola through the best one's neighbours.
    """
    from skimage.feature import match_template

    half, reach = round(0.5 * BLOCK_MM / probe.mm_per_px), round(SEARCH_MM / probe.mm_per_px)
    pixels = np.rint(places_mm / probe.mm_per_px + np.array(probe.apex_px)).astype(int)
    moved, score = np.empty((len(pixels), 2)), np.empty(len(pixels))
    for n, (column, row) in enumerate(pixels):
        block = first[row - half : row + half + 1, column - half : column + half + 1]
        wide = half + reach
        window = second[row - wide : row + wide + 1, column - wide : column + wide + 1]
        found = match_template(window.astype(np.float64), block.astype(np.float64))
        best = np.unravel_index(int(found.argmax()), found.shape)
        i, j = (int(np.clip(b, 1, 2 * reach - 1)) for b in best)
        score[n] = found[i, j]
        shift = (j + _vertex(found[i, j - 1 : j + 2]), i + _vertex(found[i - 1 : i + 2, j]))
        moved[n] = (np.array(shift) - reach) * probe.mm_per_px
    return Match((pixels - np.array(probe.apex_px)) * probe.mm_per_px, moved, score)


def block_matching_gates(shift_mm: tuple[float, float] = (1.37, -0.83), turn_deg: float = 1.2) -> list[Gate]:
    """Median error of the displacement found where tissue moves by a known rigid motion in the plane."""
    probe, turn = STANDARD, np.deg2rad(turn_deg)
    moving = medium(Tissue.LV_MYOCARDIUM, shift_mm=(*shift_mm, 0.0), turn_rad=(0.0, 0.0, float(turn)))
    pose = Rigid.identity("mr", "plane")
    images = [
        simulate_frame(moving, probe, pose, np.full(probe.lines, phase), seed=1, frame=i)
        for i, phase in enumerate((0.0, 0.5))
    ]
    match = match_blocks(images[0], images[1], probe, block_places(probe))
    turned = match.places @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    error = np.abs(match.moved - (turned + np.array(shift_mm) - match.places))
    # near the middle of the sector the image's axes are the beam's
    return [
        Gate("block matching, median lateral error, mm", float(np.median(error[:, 0])), 0.0, LATERAL_MM),
        Gate("block matching, median axial error, mm", float(np.median(error[:, 1])), 0.0, AXIAL_MM),
        Gate("block matching, blocks within 1 mm", float((error.max(axis=1) < 1.0).mean()), 0.9, 1.0),
    ]


def block_places(probe: SectorProbe) -> FloatArray:
    """(n, 2) lateral and depth of blocks from near to far within 15° of the middle line."""
    depth, angle = np.meshgrid(np.arange(35.0, 126.0, 10.0), np.deg2rad([-15, -8, 0, 8, 15]), indexing="ij")
    return np.column_stack([(depth * np.sin(angle)).ravel(), (depth * np.cos(angle)).ravel()])


def _vertex(three: FloatArray) -> float:
    """Where a parabola through three values at −1, 0, 1 has its top."""
    bend = three[0] - 2 * three[1] + three[2]
    return 0.0 if bend >= 0 else float(0.5 * (three[0] - three[2]) / bend)
