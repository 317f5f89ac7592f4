"""`dvf-ig study operators`: simulated operators at the evaluation tasks of Ren 2008."""

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, command, cores_or, emit, progress, warn, wrote

from .options import FirstSeedOption, FolderOption, SchedulerOption, SeedsOption, WorkersOption

if TYPE_CHECKING:
    from dvf_ig.study.hearts.summary import Estimate
    from dvf_ig.study.operators.summary import Difference, OperatorsSummary, Row


class TaskName(StrEnum):
    """Evaluation tasks."""

    cutting = "cutting"
    dissection = "dissection"
    tracking = "tracking"


FIRST_OPERATOR = 1001


def operators(
    out: FolderOption,
    task: Annotated[TaskName, typer.Option("--task", help="What the operators do.")],
    seeds: SeedsOption = 20,
    seed: FirstSeedOption = FIRST_OPERATOR,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Simulated operators with and without the fixture's force; the same operators under every condition.

    Means have bootstrap 95 % intervals over operators; differences are paired, with effect size d_z.
    """
    with command(lists_inputs=False):
        from dataclasses import asdict

        from dvf_ig.io import output_folder, write_json
        from dvf_ig.io.writing.atomic import write_bytes
        from dvf_ig.report.study.operators import operators_png
        from dvf_ig.study.operators.assumptions import assumptions, paper_figures
        from dvf_ig.study.operators.heart import HEART_SEED, surface_of
        from dvf_ig.study.operators.shown import operators_shown
        from dvf_ig.study.operators.summary import summarise_operators
        from dvf_ig.study.operators.tracking import automatic
        from dvf_ig.study.operators.trial import operators_settings, operators_trial
        from dvf_ig.study.trials import Study, run_trials

        name = task.value
        with output_folder(out, ["summary.json"]), progress("operators") as report:
            lines = run_trials(
                Study("operators", operators_settings(name), operators_trial),
                range(seed, seed + seeds),
                out,
                workers=cores_or(workers),
                scheduler=scheduler,
                progress=report,
            )
            found = summarise_operators(name, lines)
            alone = automatic(surface_of(HEART_SEED)) if task is TaskName.tracking else None
            assumed = assumptions(name)
            summary = {
                **asdict(found),
                "seed": seed,
                "seeds": seeds,
                "automatic": alone,
                "paper": paper_figures(name),
                "assumptions": assumed,
            }
            write_json(out / "summary.json", summary)
            if found.operators:
                picture = operators_png(operators_shown(found, lines, assumed))
                write_bytes(out / f"{name}.png", picture)
        if found.failed:
            warn(f"{found.failed} of {seeds} trials were refused; see trials.jsonl")
        rows = _table(found, alone, paper_figures(name))
        emit(summary, rows, as_json=as_json)
        for sentence in assumed:
            typer.echo(f"assumed: {sentence}", err=True)
        for file in ("trials.jsonl", "summary.json", *([f"{name}.png"] if found.operators else [])):
            wrote(out / file)


def _table(
    found: "OperatorsSummary", alone: dict[str, float] | None, paper: dict[str, str]
) -> list[tuple[str, ...]]:
    from dvf_ig.study.operators.summary import MEASURES

    shown = MEASURES[found.task]
    rows: list[tuple[str, ...]] = [
        (f"{found.operators} simulated operators", *shown, "Ren 2008"),
        *(_row(row, shown, paper[row.condition]) for row in found.rows),
    ]
    if alone is not None:
        numbers = (f"{alone[name]:.2f}" for name in shown)
        rows.append(("automatic, in nobody's hand", *numbers, paper["automatic"]))
    rows += [("",), ("paired difference to visual only", "mean", "relative", "d_z", "better")]
    rows += [_difference(d) for d in found.differences]
    if found.ablations:
        more = (*shown, "withheld_s")
        rows += [("",), ("ablations, beating heart", *more)]
        rows += [_row(row, more) for row in found.ablations]
    return rows


def _row(row: "Row", shown: tuple[str, ...], *paper: str) -> tuple[str, ...]:
    return (row.condition, *(_estimate(row.measures[name]) for name in shown), *paper)


def _difference(d: "Difference") -> tuple[str, ...]:
    relative = "–" if d.relative is None else f"{100 * d.relative:+.0f} %"
    what = f"{d.measure}: {d.condition}"
    return (what, _estimate(d.mean), relative, _estimate(d.effect_size), f"{d.better} of {d.of}")


def _estimate(estimate: "Estimate") -> str:
    if estimate.value is None:
        return "–"
    if estimate.low is None or estimate.high is None:
        return f"{estimate.value:.2f}"
    return f"{estimate.value:.2f} ({estimate.low:.2f} to {estimate.high:.2f})"
