"""Move labels of end-diastole to end-systole by a real cine's own motion, and compare with an expert's.

Each number is also given without the motion. The unit is the patient. Structures and labels are those of
ACDC (Bernard 2018).

    dvf-ig study cines --data acdc --voxel-mm 1.5,1.5,10 -o study
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from dvf_ig.core import InvalidInputError, UnreadableFileError, Volume, VolumeSeries
from dvf_ig.core.arrays import AnyArray, BoolArray, FloatArray
from dvf_ig.io import read_json, read_labels, read_volume_series
from dvf_ig.preop import MotionOptions, axis_of_lost_spacing, dice, propagate_labels, track_cycle
from dvf_ig.preop.voxel_size import with_voxel_size
from dvf_ig.study.driver import Driver, Result, Rows, Study
from dvf_ig.study.options import option
from dvf_ig.study.statistics import number_text

VOXEL_HELP = "Voxel size where the header has lost it, three numbers of mm, for example 1.5,1.5,10."


@dataclass(frozen=True, kw_only=True)
class CinesSettings:
    """Options of the study."""

    data: Path = option(
        "Folder of patients, each with cine_4d.nii.gz, ed_labels.nii.gz, es_labels.nii.gz (1 right "
        "ventricle, 2 myocardium, 3 left ventricle) and frames.json."
    )
    patients: str | None = option("Only folders that end so: 002,003 (default: all).", None)
    voxel_mm: tuple[float, float, float] | None = option(VOXEL_HELP, None)


CINE, ED, ES, FRAMES = "cine_4d.nii.gz", "ed_labels.nii.gz", "es_labels.nii.gz", "frames.json"


@dataclass(frozen=True, slots=True, eq=False)
class LabelledCine:
    """One patient.

    Attributes:
        name: of the folder.
        image: all frames.
        ed, es: the expert's labels.
        ed_phase, es_phase: the frames that they belong to, counted from 0.
        spacing_given: the header had lost the voxel size; it was given.
    """

    name: str
    image: VolumeSeries
    ed: Volume
    es: Volume
    ed_phase: int
    es_phase: int
    spacing_given: bool


def labelled_cines(folder: Path, names: tuple[str, ...] = ()) -> tuple[Path, ...]:
    """Folders of patients, in order of their names.

    Args:
        names: only folders whose name ends with one of these; none means all.
    Raises:
        InvalidInputError: there is none.
    """
    folders = sorted(path.parent for path in folder.glob(f"*/{CINE}"))
    chosen = tuple(path for path in folders if not names or path.name.endswith(names))
    if not chosen:
        raise InvalidInputError(
            f"{folder} has no patient's folder {' or '.join(names)} with {CINE}, {ED}, {ES} and {FRAMES}"
        )
    return chosen


def read_labelled_cine(folder: Path, voxel_mm: tuple[float, float, float] | None = None) -> LabelledCine:
    """One patient's cine and labels.

    Args:
        voxel_mm: voxel size of cines whose header has lost it; others keep theirs.
    Raises:
        UnreadableFileError: a file is missing or is not what it should be.
        InvalidInputError: the header has lost the voxel size and none is given, or grids that do not agree.
    """
    image = read_volume_series(folder / CINE)
    (ed,), (es,) = read_labels(folder / ED), read_labels(folder / ES)
    frames = read_json(folder / FRAMES, "the numbers of the labelled frames")
    try:
        first = int(frames["first_frame"])
        ed_phase, es_phase = int(frames["ed_frame"]) - first, int(frames["es_frame"]) - first
    except (TypeError, ValueError, KeyError) as exc:
        raise UnreadableFileError(
            f"cannot read {folder / FRAMES}; needed ed_frame, es_frame and first_frame"
        ) from exc
    if not ed.grid.shape == es.grid.shape == image.grid.shape:
        raise InvalidInputError(f"labels and cine of {folder} have voxels of different numbers")
    if not (0 <= ed_phase < len(image.timing) and 0 <= es_phase < len(image.timing)):
        raise InvalidInputError(f"{folder / FRAMES} names frames that the cine does not have")
    lost = axis_of_lost_spacing(image.values[ed_phase], image.grid.spacing_mm) is not None
    grid = image.grid
    if lost:
        if voxel_mm is None:
            raise InvalidInputError(
                f"the header of {folder / CINE} has lost its voxel size (it says "
                f"{', '.join(f'{s:g}' for s in grid.spacing_mm)} mm); give it, as in "
                "--voxel-mm 1.5,1.5,10"
            )
        grid = with_voxel_size(grid, voxel_mm)
    return LabelledCine(
        folder.name,
        VolumeSeries(grid, image.values, image.timing),
        Volume(grid, ed.values),
        Volume(grid, es.values),
        ed_phase,
        es_phase,
        lost,
    )


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

    Slices in which one of them has no voxel are left out; None if no slice is left.
    """
    distances: list[FloatArray] = []
    for k in range(a.shape[2]):
        first, second = (_outline(mask[..., k]) for mask in (a, b))
        if first.any() and second.any():
            for here, there in ((first, second), (second, first)):
                far_mm = ndimage.distance_transform_edt(~there, sampling=spacing_mm[:2])
                distances.append(far_mm[here])
    return float(np.concatenate(distances).mean()) if distances else None


def _outline(mask: BoolArray) -> BoolArray:
    return np.asarray(mask & ~ndimage.binary_erosion(mask))


def run(settings: CinesSettings, driver: Driver) -> Result:
    """Compare every patient's labels."""
    folders = labelled_cines(settings.data, tuple((settings.patients or "").split(",")))
    options = MotionOptions(threads=min(driver.threads, 2))
    for folder in folders:
        read_labelled_cine(folder, settings.voxel_mm)  # refused before the first is computed, not after
    patients: list[PatientAgreement] = []
    with driver.progress("cines") as report:
        for folder in folders:
            patients.append(cine_agreement(read_labelled_cine(folder, settings.voxel_mm), options))
            report(len(patients) / len(folders))
    notes = []
    for one in patients:
        if one.replaced_phases:
            notes.append(f"{one.patient}: the motion of phases {list(one.replaced_phases)} was rejected")
        if one.stiffened_phases:
            phases = list(one.stiffened_phases)
            notes.append(f"{one.patient}: phases {phases} were estimated again, stiffer")
    summary = {"voxel_mm": settings.voxel_mm, "patients": patients}
    return Result(summary, _table(patients), {"summary.json": summary}, tuple(notes))


def _table(patients: Sequence[PatientAgreement]) -> Rows:
    """Each number with the motion, and in brackets without."""
    rows: Rows = [("patient", "structure", "Dice", "inner slices", "distance mm")]
    rows += [
        (one.patient + (" (voxel size given)" if one.spacing_given else ""), *_cells([s]))
        for one in patients
        for s in one.structures
    ]
    rows += [
        (f"mean of {len(patients)}", *_cells([one.structures[i] for one in patients]))
        for i in range(len(STRUCTURES))
    ]
    return rows


def _cells(members: Sequence[StructureAgreement]) -> tuple[str, ...]:
    """Means over one structure of some patients."""

    def mean(name: str, form: str) -> str:
        values = [value for one in members if (value := getattr(one, name)) is not None]
        return number_text(sum(values) / len(values) if values else None, form, "-")

    pairs = (("dice", "dice_still"), ("dice_inner", "dice_inner_still"), ("mean_mm", "mean_still_mm"))
    forms = ("{:.3f}", "{:.3f}", "{:.2f}")
    both = (f"{mean(moved, f)} ({mean(still, f)})" for (moved, still), f in zip(pairs, forms, strict=True))
    return (members[0].structure, *both)


STUDY = Study(CinesSettings, run, trials=False, threads=True, lists_inputs=True)
