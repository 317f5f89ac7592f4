"""`dvf-ig study tracking`: a stylus held to the beating surface by a guidance fixture alone."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dvf_ig.cli.shell import JsonFlag, command, emit, output_dir, progress, wrote

from .options import FirstSeedOption, MotionName, SeedsOption

if TYPE_CHECKING:
    from dvf_ig.guidance import SimulatedDevice
    from dvf_ig.study.stylus.holding import HeldStylus, StylusRun


class DeviceName(StrEnum):
    """Simulated devices."""

    premium = "premium"
    omni = "omni"
    both = "both"


def tracking(
    out: Annotated[
        Path,
        typer.Option("-o", "--out", callback=output_dir, help="Folder for tracking.json and tracking.png."),
    ],
    motion: Annotated[
        MotionName, typer.Option("--motion", help="How the phantom beats.")
    ] = MotionName.paper5mm,
    cycles: Annotated[int, typer.Option("--cycles", min=1, help="How many.")] = 30,
    cycle_s: Annotated[float, typer.Option("--cycle-s", min=0.3, max=3.0, help="Length of a cycle.")] = 0.6,
    phases: Annotated[int, typer.Option("--phases", min=2, help="Volumes of the model in a cycle.")] = 20,
    places: Annotated[int, typer.Option("--places", min=1, help="Places on the surface.")] = 6,
    device: Annotated[DeviceName, typer.Option("--device", help="What is simulated.")] = DeviceName.both,
    seeds: SeedsOption = 1,
    seed: FirstSeedOption = 1,
    as_json: JsonFlag = False,
) -> None:
    """Distance of a held stylus to the true surface, by device and blend, with and without feed-forward."""
    with command(lists_inputs=False):
        from dvf_ig.core import part_of
        from dvf_ig.guidance import DEVICES
        from dvf_ig.guidance.blend import BLEND_CODES
        from dvf_ig.io import output_folder, write_json
        from dvf_ig.io.writing.atomic import write_bytes
        from dvf_ig.report.study.stylus import tracking_png
        from dvf_ig.study.stylus.holding import beating_surface, held_styli, hold_stylus, pool_hearts

        devices = list(DEVICES.values()) if device is DeviceName.both else [DEVICES[device.value]]
        tried = held_styli(devices, list(BLEND_CODES))
        with output_folder(out, ["tracking.json", "tracking.png"]), progress("tracking") as report:
            hearts = [
                beating_surface(
                    motion.value,
                    phases=phases,
                    cycle_s=cycle_s,
                    places=places,
                    seed=seed + k,
                    progress=part_of(lambda share: report(0.3 * share), k, seeds),
                )
                for k in range(seeds)
            ]
            runs = []
            for stylus in tried:
                runs.append(pool_hearts([hold_stylus(heart, stylus, cycles=cycles) for heart in hearts]))
                report(0.3 + 0.7 * len(runs) / len(tried))
            result = {
                "motion": motion.value,
                "cycles": cycles,
                "cycle_s": cycle_s,
                "phases": phases,
                "seed": seed,
                "seeds": seeds,
                "excursion_mm": [mm for heart in hearts for mm in heart.excursion_mm.tolist()],
                "rows": [_entry(run) for run in runs],
            }
            write_json(out / "tracking.json", result)
            write_bytes(out / "tracking.png", tracking_png(runs, motion=motion.value, cycle_s=cycle_s))
        emit(result, _rows(runs), as_json=as_json)
        for each in devices:
            typer.echo(_describe(each), err=True)
        for name in ("tracking.json", "tracking.png"):
            wrote(out / name)


def _entry(run: "StylusRun") -> dict[str, Any]:
    stylus = run.stylus
    d, law = stylus.device, stylus.law
    return {
        "device": {
            "name": d.name,
            "mass_kg": d.mass_kg,
            "viscous_n_s_per_m": d.viscous_n_s_per_m,
            "dry_n": d.dry_n,
            "resolution_mm": d.resolution_mm,
            "rate_hz": d.rate_hz,
        },
        "law": {"delta_mm": law.delta_mm, "m": law.m, "cap_n": law.cap_n},
        "feed_forward_n": stylus.feed_forward.friction_n,
        "blend": stylus.blend,
        **run.summary(),
    }


def _rows(runs: "list[StylusRun]") -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [
        ("device, law, blend", "mean mm", "RMS", "p95", "max", "worst place", "slid mm", "force N")
    ]
    for run in runs:
        s = run.summary()
        rows.append((_name(run.stylus), *(f"{value:.3f}" for value in s.values())))
    return rows


def _describe(d: "SimulatedDevice") -> str:
    return (
        f"{d.name}: {1000 * d.mass_kg:g} g, dry friction {d.dry_n:g} N, viscous {d.viscous_n_s_per_m:g} "
        f"N·s/m, sensor step {d.resolution_mm:g} mm, {d.rate_hz:g} Hz"
    )


def _name(stylus: "HeldStylus") -> str:
    law, added = stylus.law, stylus.feed_forward.friction_n
    extra = f" + {added:.3f} N with the surface" if added > 0.0 else ""
    return f"{stylus.device.name}, δ {law.delta_mm:.2f} mm m {law.m:g}{extra}, {stylus.blend}"
