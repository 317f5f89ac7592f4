"""`dvf-ig study watch`: false alarms of quiet hearts, and how soon a shift or a drift is found."""

from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, command, cores_or, emit, progress, wrote

from .hearts import ListName
from .options import FolderOption, SchedulerOption, WorkersOption

if TYPE_CHECKING:
    from dvf_ig.study.hearts.summary import Estimate
    from dvf_ig.study.watch.summary import WatchSummary


def watch(
    out: FolderOption,
    name: Annotated[
        ListName, typer.Option("--list", help="Hearts that are tuned on, that limits come from, or reported.")
    ] = ListName.reported,
    preset: Annotated[
        str, typer.Option("--preset", help="A preset in which neither patient nor probe moves.")
    ] = "calm",
    seconds: Annotated[float, typer.Option("--seconds", help="Length of each recording.")] = 60.0,
    count: Annotated[
        int | None, typer.Option("--hearts", min=1, help="The first so many of the list (default: all).")
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Watch over a pose in use while nothing happens, and while the heart is shifted or drifts.

    Alarms of quiet recordings are false; their rate has the exact Poisson interval. Shifts of 4 and 8 mm and
    drifts of 1, 3 and 10 mm a minute are put into the recorded beats; shares have intervals over hearts.
    """
    with command(lists_inputs=False):
        from dataclasses import asdict

        from data_synth.scenario.presets import ScenarioSpec
        from dvf_ig.io import output_folder, write_json
        from dvf_ig.study.hearts.lists import heart_list
        from dvf_ig.study.trials import Study, run_trials
        from dvf_ig.study.watch.summary import summarise_watch
        from dvf_ig.study.watch.trial import watch_trial

        checked = ScenarioSpec(preset=preset, seconds=seconds)
        settings = {"preset": checked.preset, "seconds": checked.seconds}
        with output_folder(out, ["summary.json"]), progress("recordings") as report:
            lines = run_trials(
                Study("watch", settings, watch_trial),
                heart_list(name.value).first_world[:count],
                out,
                workers=cores_or(workers),
                scheduler=scheduler,
                progress=report,
            )
            found = summarise_watch(lines)
            summary = {"list": name.value, **settings, **asdict(found)}
            write_json(out / "summary.json", summary)
        emit(summary, _table(found), as_json=as_json)
        wrote(out / "trials.jsonl")
        wrote(out / "summary.json")


def _table(found: "WatchSummary") -> list[tuple[str, ...]]:
    rows = [
        ("hearts (failed)", f"{found.hearts} ({found.failed})"),
        ("quiet beats", f"{found.beats} in {found.hours:.2f} h"),
        ("false alarms", str(len(found.alarms))),
        ("false alarms an hour", _estimate(found.alarms_per_hour, "{:.2f}")),
        ("unconfirmed s", f"{found.unconfirmed_s:.1f}"),
        ("shift statistic, 99 %, largest", f"{_number(found.statistic_p99)}, {_number(found.statistic_max)}"),
        ("TRE, bound, median mm", f"{_number(found.tre_median_mm)}, {_number(found.bound_median_mm)}"),
        ("bound covers", _estimate(found.bound_covers, "{:.0%}")),
    ]
    for shift in found.shifts:
        rows += [
            (f"{shift.mm:g} mm found within {beats} beats", _estimate(share, "{:.0%}"))
            for beats, share in shift.within.items()
        ]
    rows += [
        (
            f"drift of {drift.mm_per_min:g} mm/min",
            f"found in {drift.found} of {drift.drifts}; lag {_number(drift.lag_median_mm)} mm, "
            f"at most {_number(drift.lag_max_mm)}",
        )
        for drift in found.drifts
    ]
    return [("", f"{found.hearts} hearts"), *rows]


def _estimate(estimate: "Estimate", form: str) -> str:
    if estimate.value is None or estimate.low is None or estimate.high is None:
        return "–"
    return f"{form.format(estimate.value)} ({form.format(estimate.low)}–{form.format(estimate.high)})"


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
