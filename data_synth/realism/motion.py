"""Check that speckle follows the tissue, by block matching between two simulated frames."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_synth.heart.anatomy import PhantomAnatomy
from data_synth.heart.tissue import Tissue
from data_synth.ultrasound.probe import SectorProbe
from data_synth.ultrasound.sequence import simulate_frame
from data_synth.ultrasound.views import standard_view
from dvf_ig.core import FloatArray, Rigid, read_only_arrays

from .gates import STANDARD, Gate
from .media import medium

BLOCK_MM, SEARCH_MM = 12.0, 4.0
WALL_BLOCK_MM = 7.0
"""Size of a block: the width of the left ventricle's wall."""
EARLY_SYSTOLE = {"paper5mm": (0.08, 0.14), "physiological": (0.10, 0.13)}
"""Two model phases between which the wall moves by some half a millimetre."""
WALL_LATERAL_MM, WALL_AXIAL_MM = 0.6, 0.3
"""Bounds of the median errors in the beating wall, which strains and leaves the plane."""
AXIAL_MM, LATERAL_MM = 0.15, 0.3
"""Bounds of the median errors: a third of the pulse, a sixth of the beam at the focus."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Blocks followed from one image to the next, plane frame, mm.

    Attributes:
        places: (n, 2) lateral and depth of the blocks' centres in the first image.
        moved: (n, 2) measured displacement.
        score: (n,) correlation at the best match.
    """

    places: FloatArray
    moved: FloatArray
    score: FloatArray


def match_blocks(
    first: NDArray[np.uint8],
    second: NDArray[np.uint8],
    probe: SectorProbe,
    places_mm: FloatArray,
    block_mm: float = BLOCK_MM,
) -> Match:
    """Find the blocks around `places_mm` (n, 2) of the first image in the second one.

    Normalised correlation over whole pixels, refined by a parabola through the best one's neighbours.
    """
    from skimage.feature import match_template

    across_mm = probe.mm_per_px[0]
    half, reach = round(0.5 * block_mm / across_mm), round(SEARCH_MM / across_mm)
    pixels = np.rint(places_mm / probe.mm_per_px + np.array(probe.apex_px)).astype(int)
    moved, score = np.empty((len(pixels), 2)), np.empty(len(pixels))
    for n, (column, row) in enumerate(pixels):
        block = first[row - half : row + half + 1, column - half : column + half + 1]
        wide = half + reach
        window = second[row - wide : row + wide + 1, column - wide : column + wide + 1]
        scores = match_template(window.astype(np.float64), block.astype(np.float64))
        best = np.unravel_index(int(scores.argmax()), scores.shape)
        i, j = (int(np.clip(b, 1, 2 * reach - 1)) for b in best)
        score[n] = scores[i, j]
        shift = (j + _vertex(scores[i, j - 1 : j + 2]), i + _vertex(scores[i - 1 : i + 2, j]))
        moved[n] = (np.array(shift) - reach) * probe.mm_per_px
    return Match((pixels - np.array(probe.apex_px)) * probe.mm_per_px, moved, score)


def block_matching_gates(shift_mm: tuple[float, float] = (1.37, -0.83), turn_deg: float = 1.2) -> list[Gate]:
    """Check the median displacement error for tissue that moves rigidly by a known amount in the plane."""
    probe, turn = STANDARD, np.deg2rad(turn_deg)
    moving = medium(Tissue.LV_MYOCARDIUM, shift_mm=(*shift_mm, 0.0), turn_rad=(0.0, 0.0, float(turn)))
    pose = Rigid.identity("mr", "plane")
    images = [
        simulate_frame(moving, probe, pose, np.full(probe.lines, phase), seed=1, frame=i)
        for i, phase in enumerate((0.0, 0.5))
    ]
    match = match_blocks(images[0], images[1], probe, block_places())
    turned = match.places @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    error = np.abs(match.moved - (turned + np.array(shift_mm) - match.places))
    # near the middle of the sector the image's axes are the beam's
    return [
        Gate("block matching, median lateral error, mm", float(np.median(error[:, 0])), 0.0, LATERAL_MM),
        Gate("block matching, median axial error, mm", float(np.median(error[:, 1])), 0.0, AXIAL_MM),
        Gate("block matching, blocks within 1 mm", float((error.max(axis=1) < 1.0).mean()), 0.9, 1.0),
    ]


def beating_gates(heart: PhantomAnatomy, phases: tuple[float, float]) -> list[Gate]:
    """Check block matching in the wall of a beating left ventricle against its motion.

    Blocks whose tissue leaves the plane by more than a third of the slice are left out.
    """
    probe = STANDARD
    pose = standard_view("epicardial short-axis", heart.reference)
    images = [
        simulate_frame(heart, probe, pose, np.full(probe.lines, phase), seed=1, frame=i)
        for i, phase in enumerate(phases)
    ]
    places, truth = _wall_motion(heart, pose, phases)
    match = match_blocks(images[0], images[1], probe, places, WALL_BLOCK_MM)
    error = np.abs(match.moved - truth)
    return [
        Gate("beating wall, blocks", float(len(places)), 12.0, float("inf")),
        Gate("beating wall, median motion, mm", float(np.median(np.hypot(*truth.T))), 0.5, SEARCH_MM),
        Gate("beating wall, median lateral error, mm", float(np.median(error[:, 0])), 0.0, WALL_LATERAL_MM),
        Gate("beating wall, median axial error, mm", float(np.median(error[:, 1])), 0.0, WALL_AXIAL_MM),
    ]


def _wall_motion(
    heart: PhantomAnatomy, pose: Rigid, phases: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """List (n, 2) points in the middle of the wall at the first phase, and their displacement, plane, mm."""
    depth, angle = np.meshgrid(
        np.arange(35.0, 121.0, 4.0), np.deg2rad(np.arange(-24, 25, 4.0)), indexing="ij"
    )
    flat = np.column_stack([(depth * np.sin(angle)).ravel(), (depth * np.cos(angle)).ravel()])
    around = 0.35 * WALL_BLOCK_MM * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    inside = np.ones(len(flat), dtype=np.bool_)
    for offset in around:
        at = pose.apply_array(np.column_stack([flat + offset, np.zeros(len(flat))]))
        inside &= heart.tissue(at, phases[0]) == Tissue.LV_MYOCARDIUM
    flat = flat[inside]
    start = pose.apply_array(np.column_stack([flat, np.zeros(len(flat))]))
    material = heart.material(start, phases[0])
    there = pose.inverse().apply_array(heart.mismatch.forward(heart.deformed(material, phases[1])))
    slice_mm = STANDARD.elevation_fwhm_mm(flat[:, 1])
    stays = np.abs(there[:, 2]) < slice_mm / 3
    return flat[stays], there[stays, :2] - flat[stays]


def block_places() -> FloatArray:
    """List (n, 2) lateral and depth of blocks from near to far within 15° of the middle line."""
    depth, angle = np.meshgrid(np.arange(35.0, 126.0, 10.0), np.deg2rad([-15, -8, 0, 8, 15]), indexing="ij")
    return np.column_stack([(depth * np.sin(angle)).ravel(), (depth * np.cos(angle)).ravel()])


def _vertex(three: FloatArray) -> float:
    """Find the vertex of a parabola through three values at −1, 0, 1."""
    bend = three[0] - 2 * three[1] + three[2]
    return 0.0 if bend >= 0 else float(0.5 * (three[0] - three[2]) / bend)
