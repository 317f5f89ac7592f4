"""`dvf-ig study replay`: synthetic interventions of every preset on many seeds, replayed and scored."""

from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, command, cores_or, emit, progress, wrote

from .options import FirstSeedOption, FolderOption, MotionName, SchedulerOption, SeedsOption, WorkersOption

if TYPE_CHECKING:
    from dvf_ig.study.replay.summary import PresetSummary


def replay(
    out: FolderOption,
    preset: Annotated[
        list[str] | None, typer.Option("--preset", help="One preset; may be repeated (default: all).")
    ] = None,
    motion: Annotated[
        MotionName, typer.Option("--motion", help="How far the heart moves.")
    ] = MotionName.paper5mm,
    seconds: Annotated[float, typer.Option("--seconds", help="Length of each intervention.")] = 60.0,
    seeds: SeedsOption = 10,
    seed: FirstSeedOption = 1,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Make interventions, replay each from raw streams to force, and score it: TRE, force, and hazard_s.

    hazard_s is the time in which a force was given on a pose more than 5 mm off; the table shows the largest
    over the seeds.
    """
    with command(lists_inputs=False):
        from dataclasses import asdict

        from data_synth.scenario.presets import PRESETS, ScenarioSpec, preset_name
        from dvf_ig.io import output_folder, write_json
        from dvf_ig.study.replay.summary import summarise_replays
        from dvf_ig.study.replay.trial import replay_trial, trial_numbers
        from dvf_ig.study.trials import Study, run_trials

        presets = list(dict.fromkeys(preset_name(name) for name in preset)) if preset else list(PRESETS)
        checked = ScenarioSpec(preset=presets[0], motion=motion.value, seconds=seconds, seed=seed)
        settings = {"presets": presets, "motion": checked.motion, "seconds": checked.seconds}
        study = Study("replay", settings, replay_trial)
        with output_folder(out, ["summary.json"]), progress("replays") as report:
            lines = run_trials(
                study,
                trial_numbers(len(presets), seed, seeds),
                out,
                workers=cores_or(workers),
                group_size=len(presets),
                scheduler=scheduler,
                progress=report,
            )
            rows = summarise_replays(lines, presets)
            summary = {**settings, "seed": seed, "seeds": seeds, "rows": [asdict(row) for row in rows]}
            write_json(out / "summary.json", summary)
        wrote(out / "trials.jsonl")
        wrote(out / "summary.json")
        emit(summary, _table(rows), as_json=as_json)


def _table(rows: "list[PresetSummary]") -> list[tuple[str, ...]]:
    head = (
        "preset",
        "guided",
        "TRE mm, worst",
        "force error N",
        "valid",
        "in contact",
        "hazard s",
        "at a stretch",
        "withheld s",
        "latched s",
        "tip seen, elsewhere",
    )
    return [head, *(_row(row) for row in rows)]


def _row(row: "PresetSummary") -> tuple[str, ...]:
    tre = "" if row.tre_median_mm is None else f"{row.tre_median_mm:.2f}, {row.tre_worst_mm:.2f}"
    return (
        row.preset,
        f"{row.guided} of {row.seeds}",
        tre,
        _number(row.force_error_n, "{:.3f}"),
        _number(row.valid_share, "{:.0%}"),
        _number(row.served_share, "{:.0%}"),
        _number(row.hazard_s, "{:.2f}"),
        _number(row.hazard_longest_s, "{:.2f}"),
        _number(row.withheld_s, "{:.1f}"),
        _number(row.latched_s, "{:.1f}"),
        f"{row.tip_seen}, {row.tip_elsewhere}",
    )


def _number(value: float | None, form: str) -> str:
    return "" if value is None else form.format(value)
