"""`dvf-ig model build --image 4D`: from an image and its labels or seeds to the model, with evidence."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from dvf_ig.cli.shell import emit, progress, warn, wrote
from dvf_ig.core import DvfModel, Volume, VolumeSeries

if TYPE_CHECKING:
    from dvf_ig.preop import CineModel, ModelOptions

METHODS = ("bspline", "demons")


@dataclass(frozen=True, slots=True)
class ImageRequest:
    """What the user typed.

    Attributes:
        image: 4-D image.
        labels, seeds: one of them.
        organ, cavity: label values.
        ed_phase, method, timing, patient, surface: as the options of the same names.
        output: the model's file; JSON and picture go beside it.
    """

    image: Path
    labels: Path | None
    seeds: Path | None
    organ: tuple[int, ...]
    cavity: tuple[int, ...]
    ed_phase: int
    method: str
    timing: Path | None
    patient: str | None
    surface: str
    output: Path


def model_from_image(
    request: ImageRequest, options: "ModelOptions", *, as_json: bool
) -> tuple[DvfModel, dict[str, Any]]:
    """Segment if need be, carry, fit; print the evidence, write it and a picture beside the model."""
    from dvf_ig.io import read_volume_series, write_json, write_motion_picture
    from dvf_ig.preop import CineOptions, MotionOptions, model_from_cine

    if request.method not in METHODS:
        raise typer.BadParameter(f"--motion is '{request.method}'; needed one of {', '.join(METHODS)}")
    if (request.labels is None) == (request.seeds is None):
        raise typer.BadParameter("--image needs either --labels (of end-diastole) or --seeds FILE")
    image = read_volume_series(request.image, request.timing)
    labels, truth, cavity = _labels(request, image)
    motion = MotionOptions(
        method="demons" if request.method == "demons" else "bspline", threads=options.threads
    )
    with progress("motion, then fitting phases") as report:
        result = model_from_cine(
            image,
            labels,
            patient_id=request.patient or request.image.name.split(".")[0],
            options=CineOptions(request.organ, cavity, request.ed_phase, request.surface, motion, options),
            truth=truth,
            progress=report,
            sources=(f"{request.image.name}: motion by {request.method}",),
        )
    payload = _payload(result, request)
    evidence, picture = request.output.with_suffix(".json"), request.output.with_suffix(".png")
    write_json(evidence, payload)
    es_phase = int(result.volume_mm3.argmin())
    write_motion_picture(
        picture, image, result.surfaces, result.quality, ed_phase=request.ed_phase, es_phase=es_phase
    )
    wrote(evidence)
    wrote(picture, image.grid.frame)
    _tell_limits(result, request)
    if not as_json:
        emit({}, _phase_rows(result), as_json=False)
        emit({}, _summary_rows(result), as_json=False)
    return result.model, payload


def _labels(
    request: ImageRequest, image: VolumeSeries
) -> tuple[Volume, VolumeSeries | None, tuple[int, ...]]:
    """Labels of end-diastole, those of every phase where given, and the cavity's values."""
    from dvf_ig.io import read_cine_labels, read_seeds, write_volume
    from dvf_ig.preop import segment_from_seeds
    from dvf_ig.preop.segment.seeded import CAVITY

    if request.labels is not None:
        labels, truth = read_cine_labels(request.labels, image, request.ed_phase)
        return labels, truth, request.cavity
    if request.seeds is None:
        raise typer.BadParameter("--image needs either --labels or --seeds")
    if request.organ or request.cavity:
        raise typer.BadParameter("--organ and --cavity belong to --labels; seeds name what they are in")
    seeds = read_seeds(request.seeds, image.grid.frame)
    labels = segment_from_seeds(image.phase(request.ed_phase), seeds)
    path = request.output.with_name(f"{request.output.stem}_ed_labels.nii.gz")
    write_volume(labels, path)
    wrote(path, labels.grid.frame)
    warn(f"labels grown from seeds are a start: correct {path.name} by hand and give it as --labels")
    return labels, None, (CAVITY,) if len(seeds.cavity) else ()


def _tell_limits(result: "CineModel", request: ImageRequest) -> None:
    quality = result.quality
    if quality.slice_pitch_mm is not None:
        warn(
            f"slices lie {quality.slice_pitch_mm:.1f} mm apart: motion was sought within them only, motion "
            "across them (shortening of the heart) is missing, and shape between two of them is interpolated"
        )
    if quality.folds:
        worst = int(quality.folded_share.argmax())
        warn(f"the motion folds in {quality.folded_share[worst]:.2%} of the voxels of phase {worst}")
    if int(result.volume_mm3.argmax()) != request.ed_phase:
        warn(
            f"the volume is largest in phase {int(result.volume_mm3.argmax())}, not in the labelled phase "
            f"{request.ed_phase}"
        )


def _payload(result: "CineModel", request: ImageRequest) -> dict[str, Any]:
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
        ("phase", "correlation", "left", "min volume ratio", "folded", "Dice", "motion mm", "volume ml")
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


def _summary_rows(result: "CineModel") -> list[tuple[str, ...]]:
    quality, budget = result.quality, result.budget
    return [
        (
            "cycle closes",
            f"to {quality.closure_mean_mm:.2f} mm mean, {quality.closure_p95_mm:.2f} p95 over the organ, "
            f"where both directions meet (phase {quality.meeting_phase})",
        ),
        (
            "ED surface",
            f"voxels and triangles {budget.voxel_mm:.2f} mm SD; smoothing {budget.shrinkage_mm:.2f} mm, "
            f"compensated to {budget.residual_offset_mm:+.3f}; on a ball of radius {budget.radius_mm:.0f} mm",
        ),
    ]
