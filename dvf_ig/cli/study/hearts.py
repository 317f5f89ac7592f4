"""`dvf-ig study hearts`: registration of the hearts of a list, one trial a heart, without landmarks."""

import math
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, command, cores_or, emit, progress, wrote
from dvf_ig.cli.worlds import ImageQuality, World

from .options import FolderOption, SchedulerOption, WorkersOption

if TYPE_CHECKING:
    from dvf_ig.study.hearts.summary import Estimate, HeartGroup
    from dvf_ig.study.share import Share


class ListName(StrEnum):
    """Lists of hearts."""

    tuning = "tuning"
    threshold = "threshold"
    reported = "reported"


class ImagesName(StrEnum):
    """What is registered."""

    sweep = "sweep"
    volumes = "volumes"


def hearts(
    out: FolderOption,
    name: Annotated[
        ListName, typer.Option("--list", help="Hearts that are tuned on, that limits come from, or reported.")
    ] = ListName.reported,
    world: Annotated[
        World, typer.Option("--world", help="The second shares no table with the first; reported only.")
    ] = World.first,
    images: Annotated[
        ImagesName, typer.Option("--images", help="A tracked sweep of 14 s, or gated 3-D volumes.")
    ] = ImagesName.sweep,
    quality: Annotated[
        list[ImageQuality] | None,
        typer.Option("--quality", help="Of the images (repeatable; default: both)."),
    ] = None,
    disturbed: Annotated[
        int,
        typer.Option(
            "--disturbed",
            min=0,
            max=20,
            help="So many sweeps more of each heart and quality, with errors of calibration, clock, anatomy "
            "and start drawn for each.",
        ),
    ] = 0,
    count: Annotated[
        int | None, typer.Option("--hearts", min=1, help="The first so many of the list (default: all).")
    ] = None,
    fit: Annotated[
        list[Path] | None,
        typer.Option(
            "--fit",
            help="Register nothing: fit probability and bound on the trials of this folder (repeatable).",
        ),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Register the hearts of a list: accuracy, refusals and what the result says of itself.

    Intervals are over hearts: Wilson's of shares, bootstrap of percentiles.
    """
    if fit:
        _fit(fit, out, as_json=as_json)
        return
    with command(lists_inputs=False):
        from dataclasses import asdict

        from dvf_ig.io import output_folder, write_json
        from dvf_ig.study.hearts.conditions import conditions_of, trial_numbers
        from dvf_ig.study.hearts.lists import heart_list
        from dvf_ig.study.hearts.summary import summarise_hearts
        from dvf_ig.study.hearts.trial import heart_trial
        from dvf_ig.study.trials import Study, run_trials

        settings = {
            "world": world.value,
            "images": images.value,
            "qualities": [chosen.value for chosen in quality or ImageQuality],
            "disturbed": disturbed,
        }
        hearts_of_list = heart_list(name.value).of_world(world.value)[:count]
        conditions = len(conditions_of(settings))
        with output_folder(out, ["summary.json"]), progress("hearts") as report:
            lines = run_trials(
                Study("hearts", settings, heart_trial),
                trial_numbers(hearts_of_list, settings),
                out,
                workers=cores_or(workers),
                group_size=conditions,
                scheduler=scheduler,
                progress=report,
            )
            groups = summarise_hearts(lines)
            summary = {"list": name.value, **settings, "groups": [asdict(group) for group in groups]}
            write_json(out / "summary.json", summary)
        emit(summary, _table(groups), as_json=as_json)
        wrote(out / "trials.jsonl")
        wrote(out / "summary.json")


def _fit(folders: list[Path], out: Path, *, as_json: bool) -> None:
    """Write calibrated.json: in place of the package's own it is what registrations state from then on."""
    with command(lists_inputs=False):
        from dvf_ig.io import output_folder, write_json
        from dvf_ig.registration.evidence.assessment import TABLES
        from dvf_ig.study.hearts.fit import fit_tables
        from dvf_ig.study.trials import trials_of

        fitted = fit_tables([line for folder in folders for line in trials_of(folder)])
        with output_folder(out, [TABLES]):
            write_json(out / TABLES, fitted)
        rows = [("", "hearts", "trials", "95 % bound / prediction", "refused above, mm")]
        for kind, table in fitted["kinds"].items():
            quantile = table["bound_quantile"]
            factor = "–" if quantile is None else f"{math.exp(quantile):.2f}"
            limit = f"{math.exp(table['largest']):.2f}"
            rows.append((kind, str(table["hearts"]), str(table["trials"]), factor, limit))
        emit(fitted, rows, as_json=as_json)
        wrote(out / TABLES)


def _table(groups: "list[HeartGroup]") -> list[tuple[str, ...]]:
    """One column a group, one row a figure."""
    rows: list[tuple[str, ...]] = [("", *(_heading(g) for g in groups))]
    figures: dict[str, Callable[[HeartGroup], str]] = {
        "hearts": lambda g: str(g.hearts),
        "trials (failed)": lambda g: f"{g.trials} ({g.failed})",
        "below 2 mm": lambda g: _share(g.success),
        "TRE median mm": lambda g: _estimate(g.tre_median_mm),
        "TRE p95 mm": lambda g: _estimate(g.tre_p95_mm),
        "per-target p95 mm": lambda g: _estimate(g.target_p95_mm),
        "TRE with true matches, median mm": lambda g: _estimate(g.floor_median_mm),
        "TRE with true matches, p95 mm": lambda g: _estimate(g.floor_p95_mm),
        "above 3 mm refused": lambda g: _share(g.bad_refused),
        "below 2 mm refused": lambda g: _share(g.good_refused),
        "chi² of 6, mean": lambda g: _estimate(g.chi2_mean),
        "95 % region covers": lambda g: _share(g.region_covers),
        "TRE bound covers": lambda g: _share(g.bound_covers),
        "TRE bound median mm": lambda g: _number(g.bound_median_mm),
        "calibration error": lambda g: _number(g.calibration_error),
        "by chance alone": lambda g: _number(g.calibration_error_by_chance),
        "AUC": lambda g: _number(g.auc),
        "outside calibration": lambda g: str(g.outside),
        "seconds": lambda g: _number(g.seconds_median),
    }
    return rows + [(label, *(figure(g) for g in groups)) for label, figure in figures.items()]


def _heading(group: "HeartGroup") -> str:
    return f"{group.images}, {group.quality}" + (", disturbed" if group.disturbed else "")


def _share(share: "Share") -> str:
    if share.share is None or share.low is None or share.high is None:
        return "–"
    return f"{share.count} of {share.of}: {share.share:.0%} ({share.low:.0%}–{share.high:.0%})"


def _estimate(estimate: "Estimate") -> str:
    if estimate.low is None or estimate.high is None:
        return _number(estimate.value)
    return f"{_number(estimate.value)} ({estimate.low:.2f}–{estimate.high:.2f})"


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
