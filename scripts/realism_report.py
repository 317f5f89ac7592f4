"""Measure the realism gates, print them, and write the page; see `scripts/realism`."""

import os
import sys
import time
from dataclasses import fields, replace
from pathlib import Path
from typing import Literal

import numpy as np
import SimpleITK

from data_synth import MOTIONS, ScenarioSpec, SecondWorldSpec, phantom_scenario, second_world_recording
from data_synth.heart.anatomy import PhantomAnatomy, phantom_anatomy
from data_synth.heart.motion_report import motion_report
from data_synth.realism.gates import (
    PROBE,
    STANDARD,
    Gate,
    anisotropy_gate,
    attenuation_gates,
    contrast_gates,
    elevation_gate,
    heart_gates,
    homogeneous,
    level_gates,
    point_gates,
    real_pair_gates,
    speckle_gates,
    texture_gates,
)
from data_synth.realism.grey_levels import GreyLevels, grey_levels
from data_synth.realism.motion import EARLY_SYSTOLE, beating_gates, block_matching_gates
from data_synth.realism.pictures import attenuation_db, contrasts_db, heart_views, points_db
from data_synth.ultrasound.sequence import simulate_sequence
from data_synth.ultrasound.views import standard_view
from data_synth.ultrasound.volume import MatrixProbe, simulate_volume
from dvf_ig.io import read_sequence, read_volume, write_text
from dvf_ig.io.writing.atomic import write_bytes
from dvf_ig.report import png_bytes
from scripts.realism_pictures import RealismPictures, bounds_text, realism_figure, realism_html

OUT = Path("out/realism")
DATA = Path(os.environ.get("DVF_IG_DATA", "../shared/data"))
PAIR = ("UltrasonixCurvilinearBrightnessData.igs.mha", "UltrasonixCurvilinearScanConvertedData.igs.mha")


def main() -> int:
    envelopes = homogeneous()
    gates = [*speckle_gates(envelopes), *texture_gates(envelopes), *level_gates(envelopes)]
    gates += [
        *point_gates(),
        elevation_gate(),
        *contrast_gates(),
        anisotropy_gate(),
        *attenuation_gates(),
        *block_matching_gates(),
        *_scan_conversion(),
    ]
    hearts = {m: phantom_anatomy(motion=m, mismatch_mm=1.2, seed=1) for m in MOTIONS}
    for motion, heart in hearts.items():
        gates += [
            replace(gate, name=f"{motion}: {gate.name}")
            for gate in beating_gates(heart, EARLY_SYSTOLE[motion])
        ]
    gates += _rates(hearts["physiological"])
    for motion, heart in hearts.items():
        gates += heart_gates(motion, motion_report(heart))
    _print(gates)
    shown = RealismPictures(
        envelopes,
        PROBE.depths_mm,
        PROBE.depth_mm,
        points_db(),
        contrasts_db(gates),
        attenuation_db(),
        {motion: heart_views(heart) for motion, heart in hearts.items()},
    )
    picture = png_bytes(realism_figure(shown), dpi=90)
    OUT.mkdir(parents=True, exist_ok=True)
    write_bytes(OUT / "pictures.png", picture)
    title = "How real the synthetic world is"
    compared = _compared()
    for row in compared:
        print(f"{row[0]:<18}", *(f"{cell:>15}" for cell in row[1:]))
    write_text(OUT / "index.html", realism_html(gates, picture, title, compared))
    print(f"wrote {OUT}/index.html and {OUT}/pictures.png", file=sys.stderr)
    return 0 if all(g.passed for g in gates) else 7


def _recorded() -> dict[str, GreyLevels]:
    """Grey levels of the real recordings that are there."""
    tables = {}
    if (sweep := DATA / "imfusion-liver-sweep" / "liver_sweep.npz").is_file():
        with np.load(sweep) as arrays:
            column_mm, row_mm = arrays["spacing_mm"]
            tables["liver"] = grey_levels(arrays["images"][::4], (float(row_mm), float(column_mm)))
    if (clip := DATA / "echo-clips" / "pydicom_examples_ybr_color_A4C.dcm").is_file():
        # halved from 640 columns, for which its header states region and pixel size
        frames = SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(clip))[:, 16:207, 42:298, 0]
        tables["apical 4-chamber"] = grey_levels(np.ascontiguousarray(frames), (1.02, 1.02))
    if (brain := DATA / "resect-case2" / "case2_us_0.5mm.nii.gz").is_file():
        volume = read_volume(brain)
        levels = np.clip(255.0 * volume.values.T / volume.values.max(), 0, 255).astype(np.uint8)
        along = volume.grid.spacing_mm
        tables["brain"] = grey_levels(levels[20:90:4], (float(along[1]), float(along[0])))
    return tables


def _simulated(world: str, quality: Literal["calm", "poor-image"]) -> list[GreyLevels]:
    """Grey levels of two short sweeps of a synthetic world, of hearts that are for tuning."""
    measured = []
    for seed in (1, 2):
        rows = (
            phantom_scenario(ScenarioSpec(quality, seconds=5.0, seed=1000 + seed))
            if world == "first"
            else second_world_recording(SecondWorldSpec(5000 + seed, quality, seconds=5.0)).scenario
        )
        if rows.ultrasound.images is None or rows.truth is None:
            raise TypeError("a synthetic sweep has images and their truth")
        column_mm, row_mm = rows.truth.probe_from_image.scale_mm_per_px
        measured.append(grey_levels(rows.ultrasound.images[::3], (float(row_mm), float(column_mm))))
    return measured


def _compared() -> list[list[str]]:
    """A table of grey levels: real recordings, then the ranges of both worlds; empty without recordings."""
    real = _recorded()
    if not real:
        print(f"note: no real recordings at {DATA}; set DVF_IG_DATA", file=sys.stderr)
        return []
    qualities: tuple[Literal["calm", "poor-image"], ...] = ("calm", "poor-image")
    worlds = {f"{world} {q}": _simulated(world, q) for world in ("first", "second") for q in qualities}
    rows = [["grey levels", *real, *worlds]]
    for field in fields(GreyLevels):
        ranges = [[getattr(one, field.name) for one in measured] for measured in worlds.values()]
        rows.append(
            [field.name]
            + [f"{getattr(one, field.name):.2f}" for one in real.values()]
            + [f"{min(values):.2f}–{max(values):.2f}" for values in ranges]
        )
    return rows


def _scan_conversion() -> list[Gate]:
    folder = DATA / "plus-scanconv"
    if not folder.is_dir():
        print(f"note: no real scan-conversion pair at {folder}; set DVF_IG_DATA", file=sys.stderr)
        return []
    polar, converted = (read_sequence(folder / name).images for name in PAIR)
    if polar is None or converted is None:
        raise SystemExit(f"error: the scan-conversion pair in {folder} has no images")
    return real_pair_gates(polar, converted)


def _rates(heart: PhantomAnatomy, frames: int = 24) -> list[Gate]:
    """Measure median rates on this machine's first two cores, with warm kernels and tables."""
    pose = standard_view("epicardial short-axis", heart.reference)
    phases = np.tile(np.linspace(0, 1, frames)[:, None], (1, STANDARD.lines))
    times: list[float] = []
    simulate_sequence(heart, STANDARD, [pose] * 4, phases[:4], seed=1)

    def stamp(done: int, total: int) -> None:
        times.append(time.perf_counter())

    simulate_sequence(heart, STANDARD, [pose] * frames, phases, seed=1, progress=stamp)
    # two threads finish frames in pairs: a pair's time is that of two frames
    pairs = np.subtract(times[2:], times[:-2])
    matrix = MatrixProbe()
    still = np.zeros((matrix.tall, matrix.sector.lines))
    seconds = []
    for _ in range(4):
        start = time.perf_counter()
        simulate_volume(heart, matrix, pose, still, seed=1)
        seconds.append(time.perf_counter() - start)
    return [
        Gate("192 x 768 to 512², frames/s", 2 / float(np.median(pairs)), 15.0, float("inf")),
        Gate("64 x 64 x 384, s a volume", float(np.median(seconds[1:])), 0.0, 1.0),
    ]


def _print(gates: list[Gate]) -> None:
    width = max(len(g.name) for g in gates)
    print(f"{'gate':<{width}}  {'value':>10}  {'bounds':>20}")
    for g in gates:
        print(f"{g.name:<{width}}  {g.value:>10.4g}  {bounds_text(g):>20}  {'pass' if g.passed else 'FAIL'}")


if __name__ == "__main__":
    sys.exit(main())
