"""`dvf-ig study blending`: error between phases against how many there are."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.cli.shell import (
    JsonFlag,
    ThreadsOption,
    command,
    cores_or,
    emit,
    output_dir,
    progress,
    whole_numbers,
    wrote,
)

from .options import FirstSeedOption, SeedsOption

if TYPE_CHECKING:
    from dvf_ig.study.blending.blend_errors import BlendError, BlendStudy

COUNTS = "10,15,20,30,40,50"


def blending(
    out: Annotated[
        Path,
        typer.Option("-o", "--out", callback=output_dir, help="Folder for summary.json and the picture."),
    ],
    phases: Annotated[str, typer.Option("--phases", help="Numbers of phases to compare.")] = COUNTS,
    knot_mm: Annotated[float, typer.Option("--knot-mm", help="Spline knot pitch in mm.")] = 3.6,
    threads: ThreadsOption = None,
    seeds: SeedsOption = 1,
    seed: FirstSeedOption = 1,
    as_json: JsonFlag = False,
) -> None:
    """Blends between phases, against the phantom's exact motion: 5 mm (the paper's) and physiological."""
    with command(threads, lists_inputs=False):
        from dataclasses import asdict

        from data_synth.heart.motion import MotionPreset
        from dvf_ig.io import output_folder, write_json
        from dvf_ig.io.writing.atomic import write_bytes
        from dvf_ig.report.study.blending import blending_png
        from dvf_ig.study.blending.blend_errors import blending_errors

        counts = list(whole_numbers(phases, "--phases", COUNTS))
        presets: tuple[MotionPreset, ...] = ("paper5mm", "physiological")
        studies = []
        with output_folder(out, ["summary.json", "blending.png"]):
            for motion in presets:
                with progress(f"{motion} phases") as report:
                    studies.append(
                        blending_errors(
                            motion,
                            counts,
                            knot_spacing_mm=knot_mm,
                            threads=cores_or(threads),
                            seeds=range(seed, seed + seeds),
                            progress=report,
                        )
                    )
            summary = {
                "seed": seed,
                "seeds": seeds,
                "knot_mm": knot_mm,
                "studies": [asdict(study) for study in studies],
            }
            write_json(out / "summary.json", summary)
            write_bytes(out / "blending.png", blending_png(studies))
        emit(summary, _rows(studies), as_json=as_json)
        wrote(out / "summary.json")
        wrote(out / "blending.png")


def _rows(studies: "list[BlendStudy]") -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [
        ("motion", "blend", "phases", "surface, mm", "", "", "force, mN", "", "", "blend alone, mm"),
        ("", "", "", "mean", "p95", "max", "mean", "p95", "max", "mean", "p95"),
    ]
    for study in studies:
        rows += [(study.motion, error.blend, str(error.phases), *_numbers(error)) for error in study.errors]
        rows.append((study.motion, "at the phases", str(study.at_phases.phases), *_numbers(study.at_phases)))
    return rows


def _numbers(error: "BlendError") -> tuple[str, ...]:
    surface = (error.surface_mean_mm, error.surface_p95_mm, error.surface_max_mm)
    force = (error.force_mean_n, error.force_p95_n, error.force_max_n)
    own = (error.blend_mean_mm, error.blend_p95_mm)
    return (
        *(f"{value:.3f}" for value in surface),
        *(f"{1000 * value:.1f}" for value in force),
        *("-" if value is None else f"{value:.4f}" for value in own),
    )
