"""Inverse consistency of a motion: registered back to end-diastole, points should return to their start.

A motion that does not return is estimated anew with less freedom (a stiffer deformation).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from dvf_ig.core import AnyArray, BoolArray, FloatArray

from .free_form import FreeForm
from .image_match import FreeFormOptions, match_images

LIMIT_MM = 4.0
"""RMS distance from return over any part of the organ, above which a phase is estimated anew. ACDC 002, 003,
008 and 009 as they are stay below it over the whole cycle (002: up to 3.7). Chosen on these four. No sure
sign: at an eighth of the contrast 008 has 4.2, but 009 2.9, whose RV is then worse than without motion."""

STIFFER = 10.0
"""Factor of the stiffness in those phases. Of three tried on these four (10, 30, 100), the first loses least
where the motion was right (Dice of RV 0.04 at most)."""

LEAST_PART = 0.05
"""Blood in pieces smaller than this share of the organ is judged with the organ alone."""

INVERSE_STEPS = 12


@dataclass(frozen=True, slots=True)
class Stiffened:
    """A phase whose motion did not return and was estimated anew, stiffer.

    Attributes:
        phase: its number.
        inconsistency_mm: RMS distance from return of the first estimate, in the part where it is largest.
    """

    phase: int
    inconsistency_mm: float


def parts_of(organ: BoolArray, blood: BoolArray | None) -> tuple[BoolArray, ...]:
    """The organ, and each of its pieces of blood."""
    if blood is None:
        return (organ,)
    numbers, count = ndimage.label(blood & organ)
    pieces = [numbers == k for k in range(1, count + 1)]
    return (organ, *(piece for piece in pieces if piece.sum() >= LEAST_PART * organ.sum()))


def inconsistency_mm(
    forward: FreeForm,
    images: tuple[AnyArray, AnyArray],
    mask: BoolArray,
    parts: tuple[BoolArray, ...],
    observable: BoolArray,
    options: FreeFormOptions,
) -> float:
    """RMS of |u(x) + w(x + u(x))| over the part where it is largest, w the motion back, at the coarsest blur.

    Args:
        forward: u, from end-diastole.
        images: end-diastole and the phase, on the grid of `forward`.
        mask: voxels of end-diastole that were compared.
    Source: Christensen 2001 (inverse consistency).
    """
    fixed, moving = images
    gone_mm = forward.on_voxels()
    moved = np.moveaxis(gone_mm / forward.grid.spacing_mm, -1, 0)
    there = ndimage.map_coordinates(mask.view(np.uint8), inverse_index(moved), order=0, mode="nearest") > 0
    back = match_images(
        moving,
        fixed,
        there,
        FreeForm(forward.lattice, -forward.coefficients),
        replace(options, blurs_mm=options.blurs_mm[:1]),
        observable=observable,
    )
    at = np.indices(mask.shape) + moved
    returned = [
        ndimage.map_coordinates(w, at, order=1, mode="nearest") for w in np.moveaxis(back.on_voxels(), -1, 0)
    ]
    off = ((gone_mm + np.stack(returned, axis=-1)) ** 2).sum(axis=-1)
    return max(float(np.sqrt(off[part].mean())) for part in parts)


def made_consistent(
    forward: FreeForm,
    images: tuple[AnyArray, AnyArray],
    mask: BoolArray,
    parts: tuple[BoolArray, ...],
    observable: BoolArray,
    options: FreeFormOptions,
) -> tuple[FreeForm, float]:
    """The motion, estimated anew where it does not return, and its inconsistency before; see above."""
    off_mm = inconsistency_mm(forward, images, mask, parts, observable, options)
    if off_mm <= LIMIT_MM:
        return forward, off_mm
    stiffer = replace(options, stiffness_mm2=options.stiffness_mm2 * STIFFER)
    return match_images(*images, mask, forward, stiffer, observable=observable), off_mm


def inverse_index(moved_voxels: FloatArray) -> FloatArray:
    """(3, nx, ny, nz) voxel index that each voxel centre came from: y = x − u(y), iterated.

    Args:
        moved_voxels: (3, nx, ny, nz) displacement in voxels.
    """
    here = np.indices(moved_voxels.shape[1:], dtype=np.float64)
    origin = here - moved_voxels
    for _ in range(INVERSE_STEPS):
        origin = here - np.stack(
            [ndimage.map_coordinates(u, origin, order=1, mode="nearest") for u in moved_voxels]
        )
    return origin
