"""`dvf-ig study calibration`: bias of a calibration, and whether its intervals hold the truth."""

from collections.abc import Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, command, cores_or, emit, progress, warn, wrote

from .options import FirstSeedOption, FolderOption, SchedulerOption, SeedsOption, WorkersOption

if TYPE_CHECKING:
    from dvf_ig.study.calibration.intervals import IntervalCoverage


class Kind(StrEnum):
    """Which calibration."""

    nwire = "nwire"
    wall = "wall"
    watertank = "watertank"
    crosswire = "cross-wire"


def calibration(
    kind: Annotated[Kind, typer.Option("--kind", help="Which calibration.")],
    out: FolderOption,
    seeds: SeedsOption = 200,
    method: Annotated[
        str,
        typer.Option("--method", help="N-wire: linear, orthogonal, isotropic, all-wires or chosen."),
    ] = "orthogonal",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    seed: FirstSeedOption = 1,
    as_json: JsonFlag = False,
) -> None:
    """Bias of a calibration, and how often its 95 % intervals hold the truth."""
    with command(lists_inputs=False):
        from dvf_ig.io import output_folder, write_json
        from dvf_ig.study.calibration.intervals import calibration_trial, interval_coverage
        from dvf_ig.study.trials import Study, run_trials

        settings = {"kind": kind.value} | ({"method": method} if kind is Kind.nwire else {})
        study = Study("calibration", settings, calibration_trial)
        with output_folder(out, ["summary.json"]), progress(f"{kind.value} trials") as report:
            lines = run_trials(
                study,
                range(seed, seed + seeds),
                out,
                workers=cores_or(workers),
                scheduler=scheduler,
                progress=report,
            )
            refused = [line for line in lines if "refused" in line]
            entries = interval_coverage(lines)
            summary = {
                **settings,
                "trials": seeds,
                "seed": seed,
                "refused": len(refused),
                "coverage": [_entry(entry) for entry in entries],
            }
            write_json(out / "summary.json", summary)
        if refused:
            warn(f"{len(refused)} of {seeds} trials were refused; the first: {refused[0]['refused']}")
        emit(summary, _rows(entries), as_json=as_json)
        for name in ("study.json", "trials.jsonl", "summary.json"):
            wrote(out / name)


def _entry(entry: "IntervalCoverage") -> dict[str, str | int | float]:
    return {
        "name": entry.name,
        "intervals": entry.trials,
        "share": entry.share,
        "bias": entry.bias,
        "sd": entry.sd,
        "half_width": entry.half_width,
    }


def _rows(entries: "Sequence[IntervalCoverage]") -> list[tuple[str, ...]]:
    from dvf_ig.study.calibration.intervals import GROUPS

    rows: list[tuple[str, ...]] = [("", "in interval", "of", "bias", "SD", "half-width")]
    for entry in entries:
        name = entry.name if entry.name in GROUPS else f"  {entry.name}"
        share, width = f"{100 * entry.share:.1f} %", f"{entry.half_width:.4f}"
        rows.append((name, share, str(entry.trials), f"{entry.bias:+.4f}", f"{entry.sd:.4f}", width))
    return rows
