"""Check of a model's surface against labels, or against surfaces of the same heart."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer

from dvf_ig.cli.shell import warn
from dvf_ig.core import DvfModel, InvalidInputError, Volume, VolumeSeries, nearest_phase

from .output import DEFINITIONS
from .request import BuildRequest

if TYPE_CHECKING:
    from dvf_ig.preop import LabelCheck

PHASE_POINTS = 1000
"""Random points on each of the two surfaces of a phase if labels of every phase are given."""


@dataclass(frozen=True, slots=True)
class LabelsAt:
    """Label image with its position in the cycle: a phase of the model, or a fraction of the cycle."""

    path: Path
    phase: int | None
    fraction: float


def labels_at(text: str) -> LabelsAt:
    """Parse FILE@PHASE.

    Raises:
        typer.BadParameter: another form.
    """
    name, at, place = text.rpartition("@")
    try:
        phase = int(place) if "." not in place else None
        fraction = 0.0 if phase is not None else float(place)
    except ValueError:
        phase, fraction = None, -1.0
    if not (at and name) or not 0.0 <= fraction < 1.0 or (phase is not None and phase < 0):
        raise typer.BadParameter(
            f"--labels is '{text}'; needed FILE@PHASE, where PHASE is a fraction of the cycle in [0, 1) with "
            "a decimal point (es.nii.gz@0.35) or the number of a phase (es.nii.gz@11)"
        )
    return LabelsAt(Path(name), phase, fraction)


def check_with_labels(
    model: DvfModel,
    labels_file: LabelsAt,
    organ: tuple[int, ...],
    cavity: tuple[int, ...],
    points: int,
    seed: int,
    voxel_mm: tuple[float, float, float] | None = None,
) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Measure the agreement with labels: JSON and rows to print."""
    from dvf_ig.io import read_labels
    from dvf_ig.preop import check_labels, with_voxel_size

    labels, fraction = _labels_of(model, labels_file, read_labels(labels_file.path, model.frame))
    if voxel_mm is not None:
        labels = Volume(with_voxel_size(labels.grid, voxel_mm), labels.values)

    def agreement(at: float) -> "LabelCheck":
        rng = np.random.default_rng(seed)
        return check_labels(
            model, labels, at, organ_labels=organ, cavity_labels=cavity, points=points, rng=rng
        )

    moving = agreement(fraction)
    still = agreement(float(model.timing.fractions[model.ed_phase]))
    if still.both_mm.mean() < moving.both_mm.mean():
        warn(
            f"the end-diastolic surface agrees better with these labels ({still.both_mm.mean():.2f} mm mean) "
            f"than the surface at their position in the cycle ({moving.both_mm.mean():.2f} mm): check PHASE "
            "and the motion"
        )
    payload = {
        **_numbers(moving),
        "phase": moving.fraction,
        "model_to_labels_mm": _spread(moving.model_to_labels_mm),
        "labels_to_model_mm": _spread(moving.labels_to_model_mm),
        "end_diastole": _numbers(still),
    }
    rows = [
        ("labels", f"{labels_file.path.name} at {moving.fraction:.3f} of the cycle"),
        ("Dice", f"{moving.dice:.3f}; of the end-diastolic surface, without motion, {still.dice:.3f}"),
        ("anatomical error", f"{_spread_text(moving.both_mm)}: {DEFINITIONS['anatomical_error_mm']}"),
        ("  model to labels", _spread_text(moving.model_to_labels_mm)),
        ("  labels to model", _spread_text(moving.labels_to_model_mm)),
        ("  without motion", _spread_text(still.both_mm)),
    ]
    return payload, rows


def check_with_surfaces(
    model: DvfModel, folder: Path, points: int, seed: int
) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Measure distances to a surface series at end-diastole and end-systole: JSON and rows to print."""
    from dvf_ig.io import read_surface_series
    from dvf_ig.preop import check_surface

    series = read_surface_series(folder, model.surface_name)
    fractions = model.timing.fractions
    es_phase = int(nearest_phase(fractions, np.array([model.es_fraction]))[0])
    payload: dict[str, Any] = {}
    rows = []
    for name, phase in (("end_diastole", model.ed_phase), ("end_systole", es_phase)):
        other = int(nearest_phase(series.timing.fractions, fractions[phase : phase + 1])[0])
        rng = np.random.default_rng(seed)
        check = check_surface(model, phase, series.phase(other), points=points, rng=rng)
        parts = {"whole_mm": _spread(check.whole_mm), "seen_mm": _spread(check.seen_mm)}
        payload[name] = {"phase": phase, "surface_phase": other, **parts}
        shown = "" if model.seen is None else "; of the part that slices show "
        shown += "" if model.seen is None else _spread_text(check.seen_mm)
        at = f"{name.replace('_', '-')} to {series.name}"
        rows.append((at, f"{_spread_text(check.whole_mm)}, both directions{shown}"))
    return payload, rows


def anatomical_error_mm(model: DvfModel, truth: VolumeSeries, request: BuildRequest) -> dict[str, Any]:
    """Measure distances between the model's surfaces and labels not used to build it, both directions."""
    from dvf_ig.preop import check_labels

    rng = np.random.default_rng(request.seed)
    others = [i for i in range(model.phases) if i != request.ed_phase]
    checks = [
        check_labels(
            model,
            truth.phase(i),
            float(model.timing.fractions[i]),
            organ_labels=request.organ,
            cavity_labels=request.cavity,
            points=PHASE_POINTS,
            rng=rng,
        )
        for i in others
    ]
    every = np.concatenate([check.both_mm for check in checks])
    return {
        "mean": float(every.mean()),
        "p95": float(np.percentile(every, 95)),
        "phases": others,
        "per_phase": [float(check.both_mm.mean()) for check in checks],
        "dice": [check.dice for check in checks],
    }


def _labels_of(model: DvfModel, labels_file: LabelsAt, frames: Sequence[Volume]) -> tuple[Volume, float]:
    """Choose the frame, and its position in the cycle."""
    fractions = model.timing.fractions
    if labels_file.phase is not None and labels_file.phase >= model.phases:
        raise InvalidInputError(
            f"--labels {labels_file.path}@{labels_file.phase}: the model has phases 0 to {model.phases - 1}"
        )
    if len(frames) == 1:
        phase = labels_file.phase
        return frames[0], labels_file.fraction if phase is None else float(fractions[phase])
    if len(frames) != model.phases:
        raise InvalidInputError(
            f"{labels_file.path} has labels of {len(frames)} phases, the model {model.phases}; give labels "
            "of one phase, or of each of the model's"
        )
    nearest = int(nearest_phase(fractions, np.array([labels_file.fraction]))[0])
    phase = nearest if labels_file.phase is None else labels_file.phase
    return frames[phase], float(fractions[phase])


def _numbers(check: "LabelCheck") -> dict[str, float]:
    spread = _spread(check.both_mm)
    return {"dice": check.dice, "mean_mm": spread["mean"], "p95_mm": spread["p95"]}


def _spread(distance_mm: np.ndarray[Any, Any]) -> dict[str, float]:
    return {"mean": float(distance_mm.mean()), "p95": float(np.percentile(distance_mm, 95))}


def _spread_text(distance_mm: np.ndarray[Any, Any]) -> str:
    spread = _spread(distance_mm)
    return f"{spread['mean']:.2f} mm mean, {spread['p95']:.2f} p95"
