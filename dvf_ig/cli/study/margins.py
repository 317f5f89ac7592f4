"""`dvf-ig study margins`: how deep walls stand inside the true surface with off, fixed, adaptive margins."""

from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, command, cores_or, emit, progress, wrote

from .hearts import ListName
from .options import FolderOption, SchedulerOption, WorkersOption

if TYPE_CHECKING:
    from dvf_ig.study.hearts.summary import Estimate
    from dvf_ig.study.margins.summary import MarginSummary, Violation


def margins(
    out: FolderOption,
    name: Annotated[
        ListName, typer.Option("--list", help="Hearts that are tuned on, that limits come from, or reported.")
    ] = ListName.reported,
    preset: Annotated[
        list[str] | None, typer.Option("--preset", help="May be repeated (default: calm and poor-image).")
    ] = None,
    seconds: Annotated[
        float,
        typer.Option("--seconds", min=15.0, help="Length of each recording; a pose is used from 12 s on."),
    ] = 20.0,
    count: Annotated[
        int | None, typer.Option("--hearts", min=1, help="The first so many of the list (default: all).")
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Compare margins by violation depth at equal free workspace, from raw streams to the wall.

    Errors are those that sessions make against the simulator's truth, at places all over the heart; σ is what
    the sessions state. The fixed margin is as wide as the adaptive one is in the mean.
    """
    with command(lists_inputs=False):
        from dataclasses import asdict

        from data_synth.scenario.presets import ScenarioSpec, preset_name
        from dvf_ig.io import output_folder, write_json
        from dvf_ig.io.writing.atomic import write_bytes
        from dvf_ig.report.study.margins import margins_png
        from dvf_ig.study.hearts.lists import heart_list
        from dvf_ig.study.margins.summary import summarise_margins
        from dvf_ig.study.margins.trial import margin_trial, trial_numbers
        from dvf_ig.study.trials import Study, run_trials

        presets = [preset_name(one) for one in preset or ("calm", "poor-image")]
        checked = ScenarioSpec(preset=presets[0], seconds=seconds)
        presets = list(dict.fromkeys(presets))
        settings = {"presets": presets, "seconds": checked.seconds}
        with output_folder(out, ["summary.json", "margins.png"]), progress("recordings") as report:
            lines = run_trials(
                Study("margins", settings, margin_trial),
                trial_numbers(heart_list(name.value).first_world[:count], settings),
                out,
                workers=cores_or(workers),
                group_size=len(presets),
                scheduler=scheduler,
                progress=report,
            )
            found = summarise_margins(lines)
            summary = {"list": name.value, **settings, **asdict(found)}
            write_json(out / "summary.json", summary)
            write_bytes(out / "margins.png", margins_png(found))
        emit(summary, _table(found), as_json=as_json)
        for file in ("trials.jsonl", "summary.json", "margins.png"):
            wrote(out / file)


def _table(found: "MarginSummary") -> list[tuple[str, ...]]:
    stated = found.stated
    rows: list[tuple[str, ...]] = [
        ("hearts, recordings (failed)", f"{found.hearts}, {found.recordings} ({found.failed})"),
        ("error of the wall, bias, mm", f"{found.error_mm:.2f} RMS, {found.bias_mm:+.2f}"),
        ("stated σ, mm", f"{found.sigma_mm:.2f} median, {found.sigma_spread:.0%} from heart to heart"),
        ("error over σ, RMS", f"{found.z_rms:.2f}"),
        ("mean widening, mm", f"{stated.widening_mm:.2f} at the quantile {stated.quantile:g}"),
    ]
    rows += [_row(violation) for violation in (found.off, stated.fixed, stated.adaptive)]
    rows += [
        (
            f"adaptive against fixed at {width.quantile:g}",
            _share(width.reduction),
            _share(width.mean_reduction),
        )
        for width in found.widths
    ]
    return [("", "p95 over hearts", "mean over hearts"), *rows]


def _row(violation: "Violation") -> tuple[str, ...]:
    return f"violation depth, {violation.mode}, mm", _mm(violation.p95_mm), _mm(violation.mean_mm)


def _mm(estimate: "Estimate") -> str:
    if estimate.value is None or estimate.low is None or estimate.high is None:
        return "–" if estimate.value is None else f"{estimate.value:.2f}"
    return f"{estimate.value:.2f} ({estimate.low:.2f}–{estimate.high:.2f})"


def _share(estimate: "Estimate") -> str:
    if estimate.value is None or estimate.low is None or estimate.high is None:
        return "–" if estimate.value is None else f"{-estimate.value:+.0%}"
    return f"{-estimate.value:+.0%} ({-estimate.high:+.0%} to {-estimate.low:+.0%})"
