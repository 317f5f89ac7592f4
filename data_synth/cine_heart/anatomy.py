"""Heart of a real cine: surfaces of the expert's labels carried through the cycle, and stubs of atria."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from data_synth.heart.mismatch import UNTOUCHED, SurgicalChange
from data_synth.seeds import child_rng
from data_synth.surfaces.anatomy import EPICARDIAL, LV, RV, SurfaceAnatomy, surface_anatomy
from data_synth.surfaces.atria import AtrialStub
from dvf_ig.core import (
    AnyArray,
    FloatArray,
    Grid,
    InvalidInputError,
    Preop,
    SurfaceSeries,
    Volume,
    VolumeSeries,
)

from .carried import contraction, displacement, outline
from .label_depth import Caps, StackDepth, stack_depth

RV_LABEL, MYOCARDIUM_LABEL, LV_LABEL = 1, 2, 3
LABEL_NAMES = ((RV_LABEL, "rv_blood"), (MYOCARDIUM_LABEL, "myocardium"), (LV_LABEL, "lv_blood"))
"""Label values of the ACDC experts."""
RV_WALL_MM = 2.0, 4.5
"""Thinnest and thickest wall of a right ventricle, which the experts do not label: drawn for each heart."""
CAPS = {
    LV: Caps(base_mm=8.0, apex_widths=0.8, apex_mm=0.0),
    RV: Caps(base_mm=8.0, apex_widths=0.7, apex_mm=0.0),
    EPICARDIAL: Caps(base_mm=34.0, apex_widths=0.75, apex_mm=6.0),
}
"""Caps by surface: the epicardium continues around the atria, the cavities end at their valves."""
STRIDE = {LV: 1, RV: 1, EPICARDIAL: 2}
"""Pixels between vertices, by surface."""
LEAST_HEART_MM = 30.0
"""Smallest extent along an axis of the heart in a stack of slices of an adult."""
VALVE_PLANE_MM = 11.0
"""Distance from the basal slice to the atria."""


@dataclass(frozen=True, slots=True, eq=False)
class CineHeart:
    """Data of one patient, all on the grid of the cine.

    Attributes:
        patient_id: identifier of the patient.
        cine: the real grey levels; its first phase is end-diastole.
        ed_labels: the expert's labels, with RV_LABEL, MYOCARDIUM_LABEL and LV_LABEL.
        es_labels, es_phase: the same at end-systole, and its phase of the cine.
    """

    patient_id: str
    cine: VolumeSeries
    ed_labels: Volume
    es_labels: Volume
    es_phase: int

    def __post_init__(self) -> None:
        shapes = {self.cine.grid.shape, self.ed_labels.values.shape, self.es_labels.values.shape}
        if len(shapes) != 1:
            raise InvalidInputError("cine and labels have different grids; needed labels on the cine's grid")
        if not 0 < self.es_phase < len(self.cine.timing):
            raise InvalidInputError(
                f"end-systole is phase {self.es_phase}; needed 1 to {len(self.cine.timing) - 1} "
                "(end-diastole is phase 0)"
            )
        require_heart_size(self.cine.grid, self.ed_labels.values)

    def preop(self) -> Preop:
        """Real cine with the expert's end-diastolic labels, the data that a laboratory would have."""
        values = np.asarray(self.ed_labels.values).astype(np.uint8)
        return Preop(
            patient_id=self.patient_id,
            mr=self.cine,
            ed_labels=Volume(self.cine.grid, values),
            label_names=LABEL_NAMES,
            organ_labels=(RV_LABEL, MYOCARDIUM_LABEL, LV_LABEL),
        )


def require_heart_size(grid: Grid, ed_labels: AnyArray) -> None:
    """Refuse labels that are too small for a heart, as of a cine whose header has lost its voxel size.

    Raises:
        InvalidInputError: an extent below LEAST_HEART_MM.
    """
    extents = [np.ptp(indices) + 1 if len(indices) else 0 for indices in np.nonzero(ed_labels)]
    extents_mm = np.array(extents) * grid.spacing_mm
    if extents_mm.min() < LEAST_HEART_MM:
        size = " × ".join(f"{extent_mm:.0f}" for extent_mm in extents_mm)
        raise InvalidInputError(
            f"the labelled heart is {size} mm large; needed {LEAST_HEART_MM:g} mm and more along each axis. "
            "Check the voxel size in the header of the cine (--voxel-mm X,Y,Z replaces it)"
        )


def cine_anatomy(
    heart: CineHeart, *, mismatch_mm: float, seed: int, surgery: SurgicalChange = UNTOUCHED
) -> SurfaceAnatomy:
    """Build the beating anatomy from which the ultrasound of `heart` is simulated.

    Surfaces of end-diastole are moved to those of end-systole at the pace that the cine shows. Motion along
    the surfaces, twist above all, is in neither labels nor anatomy.

    Args:
        mismatch_mm, seed, surgery: as for `surface_anatomy`; the seed draws the right ventricle's wall too.
    Raises:
        InvalidInputError: labels of fewer than three slices.
    """
    ed, es = np.asarray(heart.ed_labels.values), np.asarray(heart.es_labels.values)
    pace = contraction(heart.cine, ed > 0, heart.es_phase)
    base_first = _base_first(ed)
    wall_mm = float(child_rng(seed, "right ventricle's wall").uniform(*RV_WALL_MM))
    surfaces = {}
    for name in (EPICARDIAL, LV, RV):
        still, contracted = (_depth(name, labels, heart, base_first, wall_mm) for labels in (ed, es))
        vertices, triangles = outline(still, STRIDE[name])
        moved = displacement(vertices, triangles, contracted)
        surfaces[name] = SurfaceSeries(
            name, "mr", vertices + pace[:, None, None] * moved, triangles, heart.cine.timing, heart.patient_id
        )
    anatomy = surface_anatomy(surfaces, mismatch_mm=mismatch_mm, seed=seed, surgery=surgery)
    return replace(anatomy, atria=_atria(heart, ed, base_first))


def _depth(name: str, labels: AnyArray, heart: CineHeart, base_first: bool, wall_mm: float) -> StackDepth:
    grid = heart.cine.grid
    left = labels == LV_LABEL if name == LV else (labels == LV_LABEL) | (labels == MYOCARDIUM_LABEL)
    right = labels == RV_LABEL
    if name == RV:
        return stack_depth(right, grid, CAPS[RV], base_first=base_first)
    if name == LV:
        return stack_depth(left, grid, CAPS[LV], base_first=base_first)
    return stack_depth(
        left | _grown(right, grid.spacing_mm, wall_mm), grid, CAPS[name], base_first=base_first
    )


def _grown(mask: NDArray[np.bool_], spacing_mm: FloatArray, wall_mm: float) -> NDArray[np.bool_]:
    """Add the wall to the right ventricle's cavity, slice by slice."""
    out = np.zeros_like(mask)
    for k in range(mask.shape[2]):
        if mask[:, :, k].any():
            out[:, :, k] = distance_transform_edt(~mask[:, :, k], sampling=spacing_mm[:2]) <= wall_mm
    return out


def _base_first(labels: AnyArray) -> bool:
    """Return whether slice 0 is the basal end, where the heart is wider."""
    area = (labels > 0).sum(axis=(0, 1))
    half = len(area) // 2
    return bool(area[:half].sum() > area[-half:].sum())


def _atria(heart: CineHeart, labels: AnyArray, base_first: bool) -> AtrialStub:
    """Place the start of the atria beyond the basal slice, across the stack's axis."""
    index = np.argwhere(labels > 0)
    end = index[:, 2].min() if base_first else index[:, 2].max()
    middle = np.array([*index[index[:, 2] == end, :2].mean(axis=0), float(end)])
    along = heart.cine.grid.direction[:, 2] * (-1.0 if base_first else 1.0)
    start = heart.cine.grid.to_mm(middle[None])[0] + VALVE_PLANE_MM * along
    left, right = (_middle(heart, labels == code) for code in (LV_LABEL, RV_LABEL))
    return AtrialStub(start, along, left, right)


def _middle(heart: CineHeart, mask: NDArray[np.bool_]) -> FloatArray:
    return np.asarray(heart.cine.grid.to_mm(np.argwhere(mask).mean(axis=0)[None])[0])
