"""`dvf-ig model build --image 4D`: from an image and its labels or seeds to the model, with evidence."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer

from dvf_ig.cli.shell import emit, progress, warn, wrote
from dvf_ig.core import DvfModel, InvalidInputError, Preop, Volume, VolumeSeries

from .labels import anatomical_error_mm
from .request import BuildRequest

if TYPE_CHECKING:
    from dvf_ig.preop import CineModel, SliceShifts


@dataclass(frozen=True, slots=True)
class FileBeside:
    """File that is written together with the model, in the same folder.

    Attributes:
        write: called with the path to write.
        frame: of its coordinates, if it has any.
    """

    path: Path
    write: Callable[[Path], None]
    frame: str | None = None


@dataclass(frozen=True, slots=True)
class BuiltModel:
    """A model, and what is printed and written with it.

    Attributes:
        evidence: added to the printed result.
        beside: files of evidence.
        replaced: files of earlier evidence, which go if `beside` does not replace them.
    """

    model: DvfModel
    evidence: dict[str, Any]
    beside: tuple[FileBeside, ...] = ()
    replaced: tuple[Path, ...] = ()


def model_from_image(request: BuildRequest, path: Path, *, as_json: bool) -> BuiltModel:
    """Build a model: segment from seeds if given, propagate by the motion, and fit.

    Args:
        request: request with an image, and labels or seeds.
        path: the image.
    """
    from dvf_ig.io import require_outputs
    from dvf_ig.preop import cine_options, model_from_cine

    replaced = _paths_beside(request)
    require_outputs(request.output, *replaced)
    request, image, views = _images(request, path)
    grown = [] if request.labels is not None else [_grown(request, image)]
    image, preop, labels, truth = _sized(request, image, *_preop(request, path, image, grown))
    options = cine_options(preop, request.motion_options(), request.model_options())
    with progress("motion, then fitting phases") as report:
        result = model_from_cine(
            image,
            labels,
            patient_id=preop.patient_id,
            views=views,
            options=options,
            truth=truth,
            progress=report,
            sources=(f"{path.name}: motion by {request.method}",),
        )
    if not result.model.chambers:
        warn_of_no_blood(f"give --cavity ({describe_labels(image, labels, request.ed_phase)})")
    error = None if truth is None else anatomical_error_mm(result.model, truth, request)
    payload = {**_payload(result, request), "anatomical_error_mm": error}
    beside = [*(file for _, _, file in grown), *_evidence_files(result, image, views, payload, request)]
    _warn_of_limits(result, request)
    if not as_json:
        emit({}, _phase_rows(result), as_json=False)
        emit({}, _summary_rows(result), as_json=False)
    return BuiltModel(
        result.model, {"motion": payload, "anatomical_error_mm": error}, tuple(beside), replaced
    )


def _images(request: BuildRequest, path: Path) -> tuple[BuildRequest, VolumeSeries, tuple[VolumeSeries, ...]]:
    """Read the 4-D image and the long-axis views, and take the patient of an examination.

    Warns of every series of an examination that is left out.
    """
    from dvf_ig.io import read_dicom_examination, read_timing, read_volume_series

    if not request.examination:
        views = tuple(read_volume_series(view) for view in request.views)
        return request, read_volume_series(path, request.timing), views
    examination = read_dicom_examination(path)
    for one in examination.left_out:
        warn(f"left out {one.images} images of {one.series or 'a series without a name'}: {one.reason}")
    typer.echo(
        f"short-axis stack: {examination.sax.grid.shape[2]} slices, {len(examination.sax.timing)} phases; "
        f"long-axis views: {', '.join(examination.names) or 'none'}",
        err=True,
    )
    request = replace(request, patient=request.patient or examination.patient_id or None)
    if request.timing is None:
        return request, examination.sax, examination.views
    timing = read_timing(request.timing, folder=path, phases=len(examination.sax.timing), image=path.name)
    return request, VolumeSeries(examination.sax.grid, examination.sax.values, timing), examination.views


def _sized(
    request: BuildRequest, image: VolumeSeries, preop: Preop, labels: Volume, truth: VolumeSeries | None
) -> tuple[VolumeSeries, Preop, Volume, VolumeSeries | None]:
    """Replace the header's voxel size of image and labels by the given one."""
    from dvf_ig.preop import with_voxel_size

    if request.voxel_mm is None:
        return image, preop, labels, truth
    grid = with_voxel_size(image.grid, request.voxel_mm)
    image, labels = VolumeSeries(grid, image.values, image.timing), Volume(grid, labels.values)
    if truth is not None:
        truth = VolumeSeries(grid, truth.values, truth.timing)
    return image, replace(preop, mr=image, ed_labels=labels), labels, truth


def _paths_beside(request: BuildRequest) -> tuple[Path, Path, Path]:
    """Return the paths of JSON, of the picture, and of that of shifts between slices, next to the model."""
    output = request.output
    return output.with_suffix(".json"), output.with_suffix(".png"), output.with_suffix(".shifts.png")


def _evidence_files(
    result: "CineModel",
    image: VolumeSeries,
    views: tuple[VolumeSeries, ...],
    payload: dict[str, Any],
    request: BuildRequest,
) -> list[FileBeside]:
    """List JSON and pictures next to the model."""
    from dvf_ig.io import write_sidecar
    from dvf_ig.report import write_motion_picture
    from dvf_ig.report.examination import write_shifts_picture

    evidence, picture, shifts = _paths_beside(request)
    ed_phase, frame = request.ed_phase, image.grid.frame
    write_picture = partial(
        write_motion_picture,
        image=image,
        surfaces=result.surfaces,
        quality=result.quality,
        ed_phase=ed_phase,
        es_phase=int(result.volume_mm3.argmin()),
        caps=result.model.reference_caps[ed_phase] | result.model.unseen(ed_phase),
    )
    files = [
        FileBeside(evidence, partial(write_sidecar, content=payload, kind="model")),
        FileBeside(picture, write_picture, frame),
    ]
    if result.shifts is None:
        return files
    write_shifts = partial(
        write_shifts_picture,
        sax=image,
        view=views[0],
        shifts=result.shifts,
        ed_phase=ed_phase,
        heart_mm=result.surfaces.vertices_mm[ed_phase],
    )
    return [*files, FileBeside(shifts, write_shifts, frame)]


def _preop(
    request: BuildRequest,
    path: Path,
    image: VolumeSeries,
    grown: list[tuple[Volume, tuple[int, ...], FileBeside]],
) -> tuple[Preop, Volume, VolumeSeries | None]:
    """Combine the image with the labels of its end-diastole, and those of every phase if given.

    Args:
        grown: labels grown from seeds, where no others are given.
    """
    from dvf_ig.io import read_cine_labels, read_label_names

    truth: VolumeSeries | None = None
    names: tuple[tuple[int, str], ...] = ()
    if request.labels is None:
        [(labels, cavity, _)] = grown
    else:
        labels, truth = read_cine_labels(request.labels, image, request.ed_phase)
        cavity, names = request.cavity, read_label_names(request.labels)
    return (
        Preop(
            patient_id=request.patient_id(path),
            mr=image,
            ed_labels=labels,
            ed_phase=request.ed_phase,
            label_names=names,
            organ_labels=request.organ,
            cavity_labels=cavity,
            surface=request.surface,
        ),
        labels,
        truth,
    )


def _grown(request: BuildRequest, image: VolumeSeries) -> tuple[Volume, tuple[int, ...], FileBeside]:
    """Grow labels from seeds, to be written next to the model, and return them and the cavity's values.

    Labels of too few seeds are written at once, as no model follows.
    """
    from dvf_ig.io import read_seeds, write_volume
    from dvf_ig.preop import seed_shortage, segment_from_seeds
    from dvf_ig.preop.segment.seeded import CAVITY

    if request.seeds is None:
        raise typer.BadParameter("--image needs either --labels or --seeds")
    seeds = read_seeds(request.seeds, image.grid.frame)
    grey = image.phase(request.ed_phase)
    labels = segment_from_seeds(grey, seeds)
    path = request.output.with_name(f"{request.output.stem}_ed_labels.nii.gz")
    file = FileBeside(path, partial(write_volume, labels), labels.grid.frame)
    shortage = seed_shortage(grey, labels, seeds)
    if shortage.told:
        file.write(path)
        wrote(path, file.frame)
        raise InvalidInputError(
            f"the seeds are too few: {'; '.join(shortage.told)}. The labels grown from them are in "
            f"{path.name}"
        )
    warn(f"labels grown from seeds are a first segmentation: correct {path.name} and give it as --labels")
    return labels, (CAVITY,) if len(seeds.cavity) else (), file


def _warn_of_limits(result: "CineModel", request: BuildRequest) -> None:
    quality = result.quality
    for replaced in result.motion.replaced:
        warn(
            f"the motion of phase {replaced.phase} was rejected: {replaced.reason.value}. It is interpolated "
            "between the phases around it; check the frame"
        )
    for stiffened in result.motion.stiffened:
        warn(
            f"the motion of phase {stiffened.phase}, registered back to end-diastole, ends "
            f"{stiffened.inconsistency_mm:.1f} mm from its start: it was estimated again with less "
            "freedom; check the frame"
        )
    if result.open_ends:
        ends = " and ".join(f"slice {end.index} (across axis {'ijk'[end.axis]})" for end in result.open_ends)
        warn(
            f"the image ends within the organ at {ends}: outside, the surface is not known; it is closed "
            "half a voxel further out"
        )
    if quality.slice_pitch_mm is not None:
        warn(
            f"slices lie {quality.slice_pitch_mm:.1f} mm apart: motion was estimated within them only, and "
            f"shape between two of them is interpolated; {result.base.sentence if result.base else ''}"
        )
    if quality.folds:
        worst = int(quality.folded_share.argmax())
        warn(f"the motion folds in {quality.folded_share[worst]:.2%} of the voxels of phase {worst}")
    if int(result.volume_mm3.argmax()) != request.ed_phase:
        warn(
            f"the volume is largest in phase {int(result.volume_mm3.argmax())}, not in the labelled phase "
            f"{request.ed_phase}"
        )


def _stack_payload(result: "CineModel") -> dict[str, Any]:
    """Shifts between breath-holds and descent of the base, which long-axis views show."""
    shifts, base, phases = result.shifts, result.base, result.phases
    return {
        "slice_shifts": None
        if shifts is None
        else {
            "sax_mm": shifts.sax_mm.tolist(),
            "sax_sigma_mm": shifts.sax_sigma_mm.tolist(),
            "views_mm": shifts.views_mm.tolist(),
            "correlation_before": shifts.before,
            "correlation_after": shifts.after,
        },
        "base_descent": None
        if base is None
        else {
            "largest_mm": base.largest_mm,
            "sigma_mm": base.sigma_mm,
            "base_mm": base.base_mm.tolist(),
            "views": base.views,
        },
        "slice_end_systole": None
        if phases is None
        else {"common": phases.common_es, "slices": phases.es.tolist()},
    }


def _payload(result: "CineModel", request: BuildRequest) -> dict[str, Any]:
    quality, budget = result.quality, result.budget
    return {
        "method": request.method,
        "ed_phase": request.ed_phase,
        "correlation_before": quality.correlation_before.tolist(),
        "correlation": quality.correlation.tolist(),
        "residual": quality.residual.tolist(),
        "min_jacobian": quality.min_jacobian.tolist(),
        "folded_share": quality.folded_share.tolist(),
        "dice_before": None if quality.dice_before is None else quality.dice_before.tolist(),
        "dice": None if quality.dice is None else quality.dice.tolist(),
        "mean_motion_mm": quality.mean_motion_mm.tolist(),
        "max_motion_mm": quality.max_motion_mm.tolist(),
        "volume_ml": (result.volume_mm3 / 1000.0).tolist(),
        "closing_mm": {
            "phase": quality.meeting_phase,
            "mean": quality.closure_mean_mm,
            "p95": quality.closure_p95_mm,
        },
        "slice_pitch_mm": quality.slice_pitch_mm,
        **_stack_payload(result),
        "replaced_phases": [
            {"phase": r.phase, "reason": r.reason.name.lower(), "jump_mm": r.jump_mm}
            for r in result.motion.replaced
        ],
        "stiffened_phases": [
            {"phase": s.phase, "inconsistency_mm": s.inconsistency_mm} for s in result.motion.stiffened
        ],
        "not_known_beyond": [
            {"axis": "ijk"[end.axis], "index": end.index, "position_mm": end.position_mm.tolist()}
            for end in result.open_ends
        ],
        "segmentation_mm": {
            "voxel_sd": budget.voxel_mm,
            "shrinkage_compensated": budget.shrinkage_mm,
            "offset_left": budget.residual_offset_mm,
            "triangles": budget.chord_mm,
        },
    }


def _phase_rows(result: "CineModel") -> list[tuple[str, ...]]:
    quality = result.quality
    rows: list[tuple[str, ...]] = [
        ("phase", "correlation", "residual", "min volume ratio", "folded", "Dice", "motion mm", "volume ml")
    ]
    for i, now in enumerate(quality.correlation):
        rows.append(
            (
                str(i),
                f"{quality.correlation_before[i]:.3f} > {now:.3f}",
                f"{quality.residual[i]:.2f}",
                f"{quality.min_jacobian[i]:.2f}",
                f"{quality.folded_share[i]:.2%}",
                "-" if quality.dice is None else f"{quality.dice[i]:.3f}",
                f"{quality.mean_motion_mm[i]:.1f}, max {quality.max_motion_mm[i]:.1f}",
                f"{result.volume_mm3[i] / 1000.0:.1f}",
            )
        )
    return rows


def _shift_sentence(shifts: "SliceShifts") -> str:
    import numpy as np

    size = np.linalg.norm(shifts.sax_mm, axis=1)
    return (
        f"{size.mean():.1f} mm mean, {size.max():.1f} largest (± {np.median(shifts.sax_sigma_mm):.1f} a "
        f"coordinate), corrected; correlation along intersections {shifts.before:.3f} before, "
        f"{shifts.after:.3f} after"
    )


def _summary_rows(result: "CineModel") -> list[tuple[str, ...]]:
    quality, budget, shifts = result.quality, result.budget, result.shifts
    rows = [] if shifts is None else [("slice shifts", _shift_sentence(shifts))]
    if result.phases is not None:
        es = result.phases.es
        common = f"aligned to {result.phases.common_es:.2f}"
        rows.append(
            ("end-systole", f"at {es.min():.2f} to {es.max():.2f} of the slices' own cycles, {common}")
        )
    return [
        *rows,
        (
            "closure error",
            f"{quality.closure_mean_mm:.2f} mm mean, {quality.closure_p95_mm:.2f} p95 over the organ, "
            f"in the phase where both directions meet ({quality.meeting_phase})",
        ),
        (
            "ED surface",
            f"voxels and triangles {budget.voxel_mm:.2f} mm SD; smoothing {budget.shrinkage_mm:.2f} mm, "
            f"compensated to {budget.residual_offset_mm:+.3f}; on a ball of radius {budget.radius_mm:.0f} mm",
        ),
    ]


def warn_of_no_blood(what_to_do: str) -> None:
    """Warn that a model has no chambers of blood, with advice."""
    warn(
        "nothing states where the blood is, so the model holds no boundary of it, which registration to "
        f"ultrasound uses, and end-systole is the phase with the smallest whole volume: {what_to_do}"
    )


def describe_labels(image: VolumeSeries, labels: Volume, ed_phase: int) -> str:
    """Describe volume and mean grey level of each label at end-diastole: blood is bright in most cines."""
    voxel_ml = float(np.prod(labels.grid.spacing_mm)) / 1000.0
    grey = image.values[ed_phase]
    labels_text = []
    for value in np.unique(labels.values[labels.values != 0]).tolist():
        inside = labels.values == value
        labels_text.append(
            f"{value}: {inside.sum() * voxel_ml:.0f} ml of mean grey level {grey[inside].mean():.0f}"
        )
    return "; ".join(labels_text)
