"""Register the hearts of a list: accuracy, refusals, and what the result says about itself.

One trial a heart and condition, from a coarse start, without landmarks. Intervals are over hearts: Wilson's
for shares, bootstrap for percentiles. Hearts of the list `reported` have never been looked at before; the
second world is never tuned on. With --fit nothing is registered: probability and bound are fitted on trials
of the list `threshold`.

    dvf-ig study hearts --hearts 60 -o study
    dvf-ig study hearts --list threshold --hearts 8 --quality calm -o study
    dvf-ig study hearts --change 5mm --change retraction --quality calm --hearts 20 -o study
"""

import math
from dataclasses import dataclass, fields
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dvf_ig.core import DvfIgError, InvalidInputError
from dvf_ig.registration import PoseChart, covariance_to_mm, predicted_error_mm, target_errors_mm
from dvf_ig.registration.evidence.assessment import TABLES, features_of
from dvf_ig.study.driver import Driver, Line, Result, Rows, Settings, Study, Trials, trials_of
from dvf_ig.study.hearts import recordings
from dvf_ig.study.hearts.fit import fit_tables
from dvf_ig.study.hearts.summary import hearts_table, summarise_hearts
from dvf_ig.study.options import option


class Quality(StrEnum):
    """Presets of image quality."""

    calm = "calm"
    poor = "poor-image"


class ChangeName(StrEnum):
    """Keys of `recordings.CHANGES`."""

    unchanged = "unchanged"
    slight = "1.2mm"
    smooth = "5mm"
    retraction = "retraction"
    other_motion = "other-motion"


@dataclass(frozen=True, kw_only=True)
class HeartsSettings:
    """Options of the study."""

    list: recordings.ListName = recordings.list_option()
    world: Literal["first", "second"] = option(
        "The second shares no table with the first; reported only.", "first"
    )
    images: Literal["sweep", "sweep-of-sax", "sweep-of-sax+lax", "volumes"] = option(
        "A tracked sweep of 14 s, the same of a heart that short-axis slices alone or with long-axis views "
        "cover in part, or gated 3-D volumes.",
        "sweep",
    )
    quality: tuple[Quality, ...] = option("Image quality (repeatable; default: both).", ())
    disturbed: int = option(
        "Further sweeps of each heart and quality, with errors of calibration, clock, anatomy and start "
        "drawn for each.",
        0,
        least=0,
        most=20,
    )
    change: tuple[ChangeName, ...] = option(
        "How the patient's heart differs from that in the MR (repeatable; default: as the quality has it); "
        "errors of its walls are measured too.",
        (),
    )
    hearts: int | None = recordings.hearts_option()
    fit: tuple[Path, ...] = option(
        "Register nothing: fit probability and bound on the trials of this folder (repeatable).", ()
    )


def heart_trial(settings: Settings, number: int) -> Line:
    """One recording of one heart of a list.

    Args:
        settings: `world` ("first", "second"), `images`, `qualities` (presets of scenarios),
            `disturbed`, `changes` (see `conditions_of`).
        number: of the trial.
    """
    heart, condition = recordings.of_trial(number, settings)
    named = {
        "world": settings["world"],
        "images": settings["images"],
        "quality": condition.quality,
        "disturbed": condition.disturbed,
        "heart": heart,
        "change": condition.change,
    }
    try:
        registered = recordings.registered_heart(settings, number)
    except DvfIgError as exc:
        return {**named, "refused": str(exc)}
    return {**named, **registered.drawn, **_measured(registered)}


def _measured(registered: recordings.RegisteredHeart) -> Line:
    """Errors at the targets, and what the result states about itself."""
    result, known = registered.result, registered.known
    pose, truth = result.target_from_source, known.truth
    errors = target_errors_mm(pose, truth, known.targets)
    covered = None if registered.covered is None else target_errors_mm(pose, truth, registered.covered)
    offset = PoseChart(pose, result.center_mm).coordinates(truth)
    covariance = covariance_to_mm(result.covariance) if np.isfinite(result.covariance).all() else None
    return {
        "start_mm": float(target_errors_mm(registered.start, truth, known.targets).mean()),
        "floor_mm": registered.floor_mm,
        "tre_mm": float(errors.mean()),
        "tre_p95_mm": float(np.percentile(errors, 95)),
        "tre_max_mm": float(errors.max()),
        "covered_mm": None if covered is None else float(covered.mean()),
        "covered_max_mm": None if covered is None else float(covered.max()),
        # the squared error of the pose by its covariance, of 6 degrees of freedom
        "chi2": None if covariance is None else float(offset @ np.linalg.solve(covariance, offset)),
        "covariance_scale": result.covariance_scale,
        "stop": result.stop.name,
        "usable": result.stop.usable,
        "success_probability": result.success_probability,
        "tre_bound_mm": result.tre_bound_mm,
        "features": features_of(
            result.evidence,
            result.similarity,
            predicted_error_mm(result.covariance / result.covariance_scale),
            None if result.coverage is None else result.coverage.share,
        ),
        "statistics": None if result.statistics is None else result.statistics.values(),
        "offset_mm": offset.tolist(),  # the true pose in the coordinates of `PoseChart` about the result
        "covariance_mm2": None if covariance is None else covariance.tolist(),
        "similarity": result.similarity,
        "moved_mm": result.moved_mm,
        "overlap": result.overlap,
        "sigma_mm": None if covariance is None else float(np.sqrt(np.trace(covariance) / 6.0)),
        "seconds": result.seconds,
        "walls": registered.walls,
        **_numbers_of(result.evidence),
    }


def _numbers_of(evidence: Any) -> Line:
    """Every number of the evidence by its name, None if it was not tested or is infinite."""
    values = {field.name: getattr(evidence, field.name) for field in fields(evidence)}
    return {
        name: float(value) if isinstance(value, float) and np.isfinite(value) else None
        for name, value in values.items()
        if value is None or isinstance(value, float)
    }


def run(settings: HeartsSettings, driver: Driver) -> Result:
    """Register every heart of the list, or fit tables on trials."""
    if settings.fit:
        return _fitted(settings.fit)
    plain = settings.world == "first" and settings.images == "sweep" and not settings.disturbed
    if settings.change and not plain:
        raise InvalidInputError("--change belongs to undisturbed sweeps of the first world")
    conditions: Settings = {
        "world": settings.world,
        "images": settings.images,
        "qualities": [chosen.value for chosen in settings.quality or Quality],
        "disturbed": settings.disturbed,
        "changes": [chosen.value for chosen in settings.change],
    }
    chosen = recordings.heart_list(settings.list)
    hearts = (chosen.changed if settings.change else chosen.of_world(settings.world))[: settings.hearts]
    lines = driver.trials(
        Trials("hearts", conditions, heart_trial),
        recordings.trial_numbers(hearts, conditions),
        group_size=len(recordings.conditions_of(conditions)),
    )
    groups = summarise_hearts(lines)
    summary = {"list": settings.list, **conditions, "groups": groups}
    return Result(summary, hearts_table(groups), {"summary.json": summary})


def _fitted(folders: tuple[Path, ...]) -> Result:
    """Tables that replace the package's own: registrations state them from then on."""
    tables = fit_tables([line for folder in folders for line in trials_of(folder)])
    rows: Rows = [("", "hearts", "trials", "95 % bound / prediction", "refused above, mm")]
    for kind, table in tables["kinds"].items():
        quantile = table["bound_quantile"]
        factor = "–" if quantile is None else f"{math.exp(quantile):.2f}"
        limit = f"{math.exp(table['largest']):.2f}"
        rows.append((kind, str(table["hearts"]), str(table["trials"]), factor, limit))
    return Result(tables, rows, {TABLES: tables})


STUDY = Study(HeartsSettings, run, outputs=lambda settings: (TABLES,) if settings.fit else ("summary.json",))
