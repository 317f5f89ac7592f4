"""`dvf-ig study same-image|capture|gating-error|planes|failures`: registration from known starts."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dvf_ig.cli.shell import JsonFlag, SeedOption, command, emit, progress, warn, wrote

from .options import FolderOption, SchedulerOption, WorkersOption

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dvf_ig.study.registration.summary import Group

PairsOption = Annotated[int, typer.Option("--pairs", min=1, help="Image pairs; seeds count up from --seed.")]


class Quality(StrEnum):
    """Of the images."""

    no_mismatch = "no-mismatch"
    calm = "calm"
    poor = "poor-image"


def same_image(
    out: FolderOption,
    pairs: PairsOption = 3,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    seed: SeedOption = 1,
    as_json: JsonFlag = False,
) -> None:
    """Arm A: the MR against itself; what is left is the harness's own error."""
    _study("A", (), out, pairs, 3, 20.0, False, workers, scheduler, seed, as_json)


def capture(
    out: FolderOption,
    pairs: PairsOption = 10,
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
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    seed: SeedOption = 1,
    as_json: JsonFlag = False,
) -> None:
    """Arm B: gated 3-D ultrasound to the phase-matched MR, without landmarks."""
    chosen = tuple(q.value for q in quality or [Quality.calm])
    _study("B", chosen, out, pairs, per_bin, to_mm, baseline, workers, scheduler, seed, as_json)


def gating_error(
    out: FolderOption,
    pairs: PairsOption = 3,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    seed: SeedOption = 1,
    as_json: JsonFlag = False,
) -> None:
    """Arm D: ultrasound gated up to 10 % of RR early or late, and at other heart rates."""
    _study("D", (), out, pairs, 3, 20.0, False, workers, scheduler, seed, as_json)


def planes(
    out: FolderOption,
    pairs: PairsOption = 5,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    seed: SeedOption = 1,
    as_json: JsonFlag = False,
) -> None:
    """Arm E: one to five tracked planes, with errors of the probe's calibration and clock."""
    _study("E", (), out, pairs, 3, 20.0, False, workers, scheduler, seed, as_json)


def failures(
    out: FolderOption,
    pairs: PairsOption = 10,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    seed: SeedOption = 1,
    as_json: JsonFlag = False,
) -> None:
    """Arm F: starts up to 90 mm off, deformed and wrong hearts; are failures known as such?"""
    _study("F", (), out, pairs, 3, 20.0, False, workers, scheduler, seed, as_json)


def _study(
    arm: str,
    qualities: tuple[str, ...],
    out: Path,
    pairs: int,
    per_bin: int,
    to_mm: float,
    baseline: bool,
    workers: int | None,
    scheduler: str | None,
    seed: int,
    as_json: bool,
) -> None:
    with command():
        import os

        from dvf_ig.io import output_folder, plain, write_json
        from dvf_ig.study.registration.experiments import (
            registration_trial,
            settings_of,
            trial_numbers,
            trials_together,
        )
        from dvf_ig.study.registration.page import write_capture_page
        from dvf_ig.study.registration.summary import summarise_capture
        from dvf_ig.study.trials import Study, run_trials

        settings = settings_of(arm, qualities, per_bin, to_mm, baseline)
        with output_folder(out), progress(f"arm {arm}") as report:
            lines = run_trials(
                Study("registration", settings, registration_trial),
                trial_numbers(settings, seed, pairs),
                out,
                workers=workers or os.cpu_count() or 1,
                together=trials_together(settings),
                scheduler=scheduler,
                report=report,
            )
            near = summarise_capture(lines, up_to_mm=12.0)
            groups = summarise_capture(lines)
            summary: dict[str, Any] = plain(
                {"arm": arm, "pairs": pairs, "seed": seed, "groups": groups, "starts_up_to_12_mm": near}
            )
            write_json(out / "summary.json", summary)
            write_capture_page(lines, out / "report.html")
        refused = [line for line in lines if "refused" in line]
        if refused:
            warn(f"{len(refused)} of {len(lines)} trials were refused; the first: {refused[0]['refused']}")
        emit(summary, _rows(near if arm == "B" else groups), as_json=as_json)
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
