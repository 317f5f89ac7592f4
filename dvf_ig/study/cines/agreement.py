"""How well labels propagated from end-diastole agree with an expert's of end-systole, by structure."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dvf_ig.core import AnyArray, BoolArray, FloatArray
from dvf_ig.preop import MotionOptions, dice, propagate_labels, track_cycle

from .patients import LabelledCine

STRUCTURES = (("RV", 1), ("MYO", 2), ("LV", 3))
"""Labels of ACDC (Bernard 2018)."""


@dataclass(frozen=True, slots=True)
class StructureAgreement:
    """One structure of one patient at end-systole, with the motion and without.

    Attributes:
        structure: RV, MYO or LV.
        dice, dice_still: over all slices.
        dice_inner, dice_inner_still: without the first and the last slice.
        mean_mm, mean_still_mm: distance between outlines within slices, both directions.
    """

    structure: str
    dice: float
    dice_still: float
    dice_inner: float
    dice_inner_still: float
    mean_mm: float | None
    mean_still_mm: float | None


@dataclass(frozen=True, slots=True)
class PatientAgreement:
    """One patient: every structure, phases whose motion was replaced or stiffened, the voxel size given."""

    patient: str
    phases: int
    spacing_given: bool
    replaced_phases: tuple[int, ...]
    stiffened_phases: tuple[int, ...]
    structures: tuple[StructureAgreement, ...]


def cine_agreement(cine: LabelledCine, options: MotionOptions) -> PatientAgreement:
    """Propagate the labels of end-diastole to end-systole by the image's motion, and compare."""
    blood = np.isin(cine.ed.values, (1, 3))
    motion = track_cycle(cine.image, cine.ed.values > 0, ed_phase=cine.ed_phase, blood=blood, options=options)
    moved = propagate_labels(motion, cine.image, cine.ed, cine.es_phase)
    spacing = cine.image.grid.spacing_mm
    return PatientAgreement(
        cine.name,
        len(cine.image.timing),
        cine.spacing_given,
        tuple(r.phase for r in motion.replaced),
        tuple(s.phase for s in motion.stiffened),
        tuple(
            _structure(name, moved == value, cine.ed.values == value, cine.es.values == value, spacing)
            for name, value in STRUCTURES
        ),
    )


def _structure(
    name: str, moved: AnyArray, still: AnyArray, truth: AnyArray, spacing_mm: FloatArray
) -> StructureAgreement:
    inner = (..., slice(1, -1))
    return StructureAgreement(
        name,
        dice(moved, truth),
        dice(still, truth),
        dice(moved[inner], truth[inner]),
        dice(still[inner], truth[inner]),
        outline_distance_mm(moved, truth, spacing_mm),
        outline_distance_mm(still, truth, spacing_mm),
    )


def outline_distance_mm(a: BoolArray, b: BoolArray, spacing_mm: FloatArray) -> float | None:
    """Mean distance between the outlines of two masks within slices, both directions pooled.

    Slices in which one of them has no voxel are left out; None where there is no other.
    """
    found: list[FloatArray] = []
    for k in range(a.shape[2]):
        first, second = (_outline(mask[..., k]) for mask in (a, b))
        if first.any() and second.any():
            for here, there in ((first, second), (second, first)):
                far_mm = ndimage.distance_transform_edt(~there, sampling=spacing_mm[:2])
                found.append(far_mm[here])
    return float(np.concatenate(found).mean()) if found else None


def _outline(mask: BoolArray) -> BoolArray:
    return np.asarray(mask & ~ndimage.binary_erosion(mask))
