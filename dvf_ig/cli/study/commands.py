"""`dvf-ig study`: many trials with a known truth; one JSON line each, and what they say together."""

from collections.abc import Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, SeedOption, command, emit, progress, warn, wrote

from .blending import blending
from .distance import distance_maps
from .gating import gating
from .options import FolderOption, SchedulerOption, WorkersOption
from .registration import capture, failures, gating_error, planes, same_image
from .retiming import retiming
from .tracking import tracking
from .training import training

if TYPE_CHECKING:
    from dvf_ig.study.calibration.intervals import Coverage

app = typer.Typer(help="Many trials with a known truth.", no_args_is_help=True)
app.command("tracking")(tracking)
app.command("distance")(distance_maps)
app.command("blending")(blending)
app.command("gating")(gating)
app.command("retiming")(retiming)
app.command("training")(training)
app.command("same-image")(same_image)
app.command("capture")(capture)
app.command("gating-error")(gating_error)
app.command("planes")(planes)
app.command("failures")(failures)

TrialsOption = Annotated[int, typer.Option("--trials", min=1, help="How many; seeds count up from --seed.")]


class Kind(StrEnum):
    """Which calibration."""

    nwire = "nwire"
    wall = "wall"
    watertank = "watertank"
    crosswire = "cross-wire"


@app.command("calibration")
def calibration(
    kind: Annotated[Kind, typer.Option("--kind", help="Which calibration.")],
    out: FolderOption,
    trials: TrialsOption = 200,
    method: Annotated[
        str,
        typer.Option("--method", help="N-wire: linear, orthogonal, isotropic, all-wires or chosen."),
    ] = "orthogonal",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    seed: SeedOption = 1,
    as_json: JsonFlag = False,
) -> None:
    """Bias of a calibration, and how often its 95 % intervals hold the truth."""
    with command():
        import os

        from dvf_ig.io import output_folder, write_json
        from dvf_ig.study.calibration.intervals import coverage_trial, summarise_coverage
        from dvf_ig.study.trials import Study, run_trials

        settings = {"kind": kind.value} | ({"method": method} if kind is Kind.nwire else {})
        study = Study("calibration", settings, coverage_trial)
        seeds = range(seed, seed + trials)
        with output_folder(out), progress(f"{kind.value} trials") as report:
            count = workers or os.cpu_count() or 1
            lines = run_trials(study, seeds, out, workers=count, scheduler=scheduler, report=report)
            refused = [line for line in lines if "refused" in line]
            summary = {
                **settings,
                "trials": trials,
                "seed": seed,
                "refused": len(refused),
                "coverage": [_entry(entry) for entry in summarise_coverage(lines)],
            }
            write_json(out / "summary.json", summary)
        if refused:
            warn(f"{len(refused)} of {trials} trials were refused; the first: {refused[0]['refused']}")
        emit(summary, _rows(summarise_coverage(lines)), as_json=as_json)
        for name in ("study.json", "trials.jsonl", "summary.json"):
            wrote(out / name)


def _entry(entry: "Coverage") -> dict[str, str | int | float]:
    return {
        "name": entry.name,
        "intervals": entry.trials,
        "share": entry.share,
        "bias": entry.bias,
        "sd": entry.sd,
        "half_width": entry.half_width,
    }


def _rows(entries: "Sequence[Coverage]") -> list[tuple[str, ...]]:
    from dvf_ig.study.calibration.intervals import GROUPS

    rows: list[tuple[str, ...]] = [("", "in interval", "of", "bias", "SD", "half-width")]
    for entry in entries:
        name = entry.name if entry.name in GROUPS else f"  {entry.name}"
        share, width = f"{100 * entry.share:.1f} %", f"{entry.half_width:.4f}"
        rows.append((name, share, str(entry.trials), f"{entry.bias:+.4f}", f"{entry.sd:.4f}", width))
    return rows
