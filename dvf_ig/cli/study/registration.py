"""`dvf-ig study same-image|capture|gating-error|planes|failures`: registration from known starts."""

from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dvf_ig.cli.shell import JsonFlag, command, cores_or, emit, progress, warn, wrote
from dvf_ig.study.registration.experiments import CAPTURE, EXPERIMENTS, CaptureOptions, Experiment

from .options import (
    FirstSeedOption,
    FolderOption,
    SchedulerOption,
    SeedsOption,
    TrialsCommand,
    WorkersOption,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dvf_ig.study.registration.summary import Group


class Quality(StrEnum):
    """Of the images."""

    no_mismatch = "no-mismatch"
    calm = "calm"
    poor = "poor-image"


def add_registration_commands(app: typer.Typer) -> None:
    """A command for each experiment of the protocol."""
    for experiment in EXPERIMENTS:
        run = _capture if experiment is CAPTURE else _command_of(experiment)
        app.command(experiment.name, help=experiment.title, cls=TrialsCommand)(run)


def _command_of(experiment: Experiment) -> Callable[..., None]:
    def run(
        out: FolderOption,
        seeds: SeedsOption = experiment.seeds,
        workers: WorkersOption = None,
        scheduler: SchedulerOption = None,
        seed: FirstSeedOption = 1,
        as_json: JsonFlag = False,
    ) -> None:
        _study(experiment, CaptureOptions(), out, seeds, workers, scheduler, seed, as_json)

    return run


def _capture(
    out: FolderOption,
    seeds: SeedsOption = CAPTURE.seeds,
    quality: Annotated[
        list[Quality] | None, typer.Option("--quality", help="May be given again (default: calm).")
    ] = None,
    per_bin: Annotated[
        int, typer.Option("--per-bin", min=1, help="Starts in each 2 mm of start error (protocol: 20).")
    ] = 3,
    to_mm: Annotated[float, typer.Option("--to", min=2.0, max=60.0, help="Largest start error, mm.")] = 20.0,
    baseline: Annotated[
        bool, typer.Option("--baseline", help="SimpleITK's Mattes MI from 3 and 8 mm as well.")
    ] = False,
    keep: Annotated[
        Path | None,
        typer.Option("--keep-pairs", help="Also write each pair here, as files for a session."),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    seed: FirstSeedOption = 1,
    as_json: JsonFlag = False,
) -> None:
    qualities = tuple(q.value for q in quality or [Quality.calm])
    options = CaptureOptions(qualities, per_bin, to_mm, baseline)
    _study(CAPTURE, options, out, seeds, workers, scheduler, seed, as_json)
    if keep is not None:
        _keep(options, keep, seeds, seed)


def _keep(options: CaptureOptions, folder: Path, seeds: int, seed: int) -> None:
    with command():
        from dvf_ig.study.registration.experiments import settings_of, trial_numbers
        from dvf_ig.study.registration.pair_files import keep_pairs

        settings = settings_of(CAPTURE, options)
        with progress("pairs") as report:
            written = keep_pairs(settings, trial_numbers(settings, seed, seeds), folder, report)
        for place in written:
            wrote(place)


def _study(
    experiment: Experiment,
    options: CaptureOptions,
    out: Path,
    seeds: int,
    workers: int | None,
    scheduler: str | None,
    seed: int,
    as_json: bool,
) -> None:
    with command(lists_inputs=False):
        from dvf_ig.io import output_folder, write_json
        from dvf_ig.study.registration.experiments import settings_of, trial_numbers, trials_per_heart
        from dvf_ig.study.registration.page import NEAR_MM, write_capture_page
        from dvf_ig.study.registration.summary import group_entry, summarise_trials
        from dvf_ig.study.registration.trial import registration_trial
        from dvf_ig.study.trials import Study, run_trials

        settings = settings_of(experiment, options)
        with output_folder(out, ["summary.json", "report.html"]), progress(experiment.name) as report:
            lines = run_trials(
                Study("registration", settings, registration_trial),
                trial_numbers(settings, seed, seeds),
                out,
                workers=cores_or(workers),
                group_size=trials_per_heart(settings),
                scheduler=scheduler,
                progress=report,
            )
            near = summarise_trials(lines, up_to_mm=NEAR_MM)
            groups = summarise_trials(lines)
            summary: dict[str, Any] = {
                "arm": experiment.letter,
                "pairs": seeds,
                "seed": seed,
                "groups": [group_entry(group) for group in groups],
                "starts_up_to_12_mm": [group_entry(group) for group in near],
            }
            write_json(out / "summary.json", summary)
            write_capture_page(lines, out / "report.html")
        refused = [line for line in lines if "refused" in line]
        if refused:
            warn(f"{len(refused)} of {len(lines)} trials were refused; the first: {refused[0]['refused']}")
        emit(summary, _rows(near if experiment is CAPTURE else groups), as_json=as_json)
        for name in ("study.json", "trials.jsonl", "summary.json", "report.html"):
            wrote(out / name)


def _rows(groups: "Sequence[Group]") -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [
        ("", "runs", "TRE median", "p95 mm", "rotation p95 deg", "< 2 mm", "usable", "median s")
    ]
    for g in groups:
        name = " · ".join(part for part in (g.method, g.motion, g.quality, g.condition) if part)
        rows.append(
            (
                name,
                str(g.n),
                _number(g.tre_mm.median),
                _number(g.tre_mm.p95),
                _number(g.rotation_deg.p95),
                _percent(g.success.share),
                _percent(None if g.usable is None else g.usable.share),
                _number(g.seconds.median),
            )
        )
    return rows


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f} %"
