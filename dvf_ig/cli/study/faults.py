"""`dvf-ig study faults`: every hazard of the table put into the streams of a session, and a clean run."""

from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, command, cores_or, emit, progress, wrote

from .options import FirstSeedOption, FolderOption, SchedulerOption, SeedsOption, WorkersOption

if TYPE_CHECKING:
    from dvf_ig.study.faults.summary import RowSummary


def faults(
    out: FolderOption,
    seeds: SeedsOption = 20,
    seed: FirstSeedOption = 2001,
    hours: Annotated[float, typer.Option("--hours", min=0.1, help="Simulated hours without a fault.")] = 8.0,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Put every hazard of the table into the streams, at three severities; count false alarms without one.

    Session, supervisor and servo are the real ones; images are not made: what they would say of the pose is
    told. summary.json: `hazards` rows, `detected` in every trial within their limit, `missed` the others,
    `false_alarms` of the clean run; faults.html is the page.
    """
    with command(lists_inputs=False):
        from dataclasses import asdict
        from math import ceil

        from dvf_ig.io import files_together, output_folder, write_json, write_text
        from dvf_ig.report.study.faults import faults_page
        from dvf_ig.study.faults.clean import SECONDS, clean_trial
        from dvf_ig.study.faults.summary import summarise_clean, summarise_faults, table_counts
        from dvf_ig.study.faults.trial import CASES, fault_trial, trial_numbers
        from dvf_ig.study.trials import Study, run_trials

        clean_seeds = range(seed, seed + ceil(hours * 3600.0 / SECONDS))
        with output_folder(out, ["summary.json", "faults.html"]), output_folder(out / "clean"):
            with progress("faults") as report:
                lines = run_trials(
                    Study("faults", {}, fault_trial),
                    trial_numbers(seed, seeds),
                    out,
                    workers=cores_or(workers),
                    group_size=CASES,
                    scheduler=scheduler,
                    progress=report,
                )
            with progress("clean interventions") as report:
                quiet = run_trials(
                    Study("clean interventions", {}, clean_trial),
                    clean_seeds,
                    out / "clean",
                    workers=cores_or(workers),
                    scheduler=scheduler,
                    progress=report,
                )
            rows, clean = summarise_faults(lines), summarise_clean(quiet)
            counts = {**table_counts(rows), "false_alarms": clean.false_alarms}
            summary = {
                **counts,
                "seed": seed,
                "seeds": seeds,
                "clean": asdict(clean),
                "rows": [asdict(row) for row in rows],
            }
            with files_together(out) as new:
                write_json(new / "summary.json", summary)
                write_text(new / "faults.html", faults_page(rows, counts, clean.raised, clean.hours))
        wrote(out / "trials.jsonl")
        wrote(out / "clean" / "trials.jsonl")
        wrote(out / "summary.json")
        wrote(out / "faults.html")
        emit(summary, _table(rows), as_json=as_json)


def _table(rows: "list[RowSummary]") -> list[tuple[str, ...]]:
    from dvf_ig.report.study.faults import shown_s

    table: list[tuple[str, ...]] = [
        ("hazard", "severity", "detected", "median, largest", "limit", "force in error", "back")
    ]
    for row in rows:
        for one in row.severities:
            error = "" if one.error_n is None else f"{one.error_n:.2f} N for {shown_s(one.error_s)}"
            table.append(
                (
                    row.name,
                    one.label,
                    f"{one.detected} of {one.trials}",
                    f"{shown_s(one.median_s)}, {shown_s(one.largest_s)}",
                    shown_s(one.limit_s),
                    error,
                    f"{one.recovered} of {one.recoverable}" if one.recoverable else "",
                )
            )
    return table
