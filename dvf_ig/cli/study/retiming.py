"""`dvf-ig study retiming`: uniform against two-segment retiming at the moving surface."""

from pathlib import Path
from typing import Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, command, emit, output_dir, wrote

from .options import FirstSeedOption, SeedsOption


def retiming(
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", callback=output_dir, help="Write summary.json and retiming.png here."),
    ] = None,
    motion: Annotated[str, typer.Option("--motion", help="paper5mm or physiological.")] = "physiological",
    seeds: SeedsOption = 1,
    seed: FirstSeedOption = 1,
    as_json: JsonFlag = False,
) -> None:
    """Model phase error in mm at the moving surface, 45 to 120 beats/min, for each way of retiming."""
    with command(lists_inputs=False):
        from dataclasses import asdict

        from data_synth.heart.anatomy import RR_S
        from data_synth.heart.motion import PRESET_SCALE, MotionPreset
        from dvf_ig.cardiac import SYSTOLE_SLOPE_S_PER_BPM
        from dvf_ig.core import InvalidInputError
        from dvf_ig.io import files_together, output_folder, write_json
        from dvf_ig.report import write_png
        from dvf_ig.report.study.retiming import retiming_figure
        from dvf_ig.study.retiming.surface_error import RATES_BPM, compare_retiming

        if motion not in PRESET_SCALE:
            raise InvalidInputError(f"motion '{motion}' is unknown; choose {', '.join(PRESET_SCALE)}")
        chosen: MotionPreset = "paper5mm" if motion == "paper5mm" else "physiological"
        rows = compare_retiming(RATES_BPM, motion=chosen, seeds=range(seed, seed + seeds))
        summary = {
            "motion": motion,
            "model_rate_bpm": 60.0 / RR_S,
            "seed": seed,
            "seeds": seeds,
            "rows": [asdict(row) for row in rows],
        }
        if out is not None:
            with output_folder(out, ["summary.json", "retiming.png"]), files_together(out) as folder:
                write_json(folder / "summary.json", summary)
                figure = retiming_figure(
                    rows, model_rate_bpm=60.0 / RR_S, assumed_slope_s_per_bpm=SYSTOLE_SLOPE_S_PER_BPM
                )
                write_png(folder / "retiming.png", figure, dpi=130)
            wrote(out / "summary.json")
            wrote(out / "retiming.png")
        table: list[tuple[str, ...]] = [
            ("true k, ms per /min", "beats/min", "method", "mean mm", "p95 mm", "max mm", "systole p95 mm")
        ]
        for r in rows:
            numbers = (r.mean_mm, r.p95_mm, r.max_mm, r.systole_p95_mm)
            slope = f"{1000 * r.true_slope_s_per_bpm:.1f}"
            table.append((slope, f"{r.rate_bpm:.0f}", r.method, *(f"{n:.2f}" for n in numbers)))
        emit(summary, table, as_json=as_json)
