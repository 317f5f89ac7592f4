"""`dvf-ig synth`: synthetic interventions with their truth."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .shell import JsonFlag, SeedOption, ThreadsOption, command, emit, progress, wrote

if TYPE_CHECKING:
    from data_synth import Motion, ReplayedPath, ScenarioSpec
    from dvf_ig.core import Scenario

app = typer.Typer(no_args_is_help=True, help="Make synthetic recordings with known truth.")

SURFACES = ("EPICARDIAL", "LV_ENDOCARDIAL", "RV_ENDOCARDIAL")
"""Read from --surfaces; all but the first where present."""


class Anatomy(StrEnum):
    """Whose heart beats."""

    phantom = "phantom"
    surfaces = "surfaces"


@app.callback()
def synth() -> None:
    """Make synthetic recordings with known truth."""


@app.command("scenario")
def scenario(
    out: Annotated[Path, typer.Option("-o", "--out", help="Scenario folder to write.")],
    anatomy: Annotated[
        Anatomy, typer.Option("--anatomy", help="The four-chamber phantom, or real surfaces.")
    ] = Anatomy.phantom,
    preset: Annotated[str, typer.Option("--preset", help="Rhythm, noise and disturbances.")] = "calm",
    motion: Annotated[
        str, typer.Option("--motion", help="Phantom only: paper5mm or physiological.")
    ] = "paper5mm",
    seconds: Annotated[float, typer.Option("--seconds", help="Length of the live part.")] = 60.0,
    surfaces: Annotated[
        Path | None, typer.Option("--surfaces", help="Folder of corresponding surfaces.")
    ] = None,
    ecg: Annotated[
        str | None, typer.Option("--ecg", help="Annotated ECG whose beats drive the heart: wfdb:RECORD.")
    ] = None,
    probe_path: Annotated[
        Path | None, typer.Option("--probe-path", help="PLUS sequence whose probe motion is replayed.")
    ] = None,
    mismatch_mm: Annotated[
        float | None, typer.Option("--mismatch-mm", help="RMS difference between MR and ultrasound anatomy.")
    ] = None,
    us_rate_hz: Annotated[float, typer.Option("--us-rate-hz", help="Ultrasound frames a second.")] = 12.0,
    as_json: JsonFlag = False,
    seed: SeedOption = 1,
    threads: ThreadsOption = None,
) -> None:
    """Simulate one intervention: pre-operative data, calibration recordings, ECG, ultrasound, tool, truth.

    The same options and seed give bit-identical recordings. With --anatomy surfaces the heart, its motion,
    the ECG and the hand motion are real; only the ultrasound is simulated. Truth goes to OUT/truth.
    """
    with command(threads):
        from data_synth import ScenarioSpec
        from dvf_ig.io import write_scenario

        spec = ScenarioSpec(preset, _motion(motion), seconds, seed, us_rate_hz, mismatch_mm)
        if anatomy is Anatomy.phantom:
            if surfaces is not None or ecg is not None or probe_path is not None:
                raise typer.BadParameter("--surfaces, --ecg and --probe-path belong to --anatomy surfaces")
            made, path = _on_the_phantom(spec), None
        else:
            if surfaces is None or ecg is None or probe_path is None:
                raise typer.BadParameter("--anatomy surfaces needs --surfaces, --ecg and --probe-path")
            made, path = _on_real_anatomy(spec, surfaces, ecg, probe_path)
        write_scenario(made, out)
        emit(_facts(made, out, path), _rows(made, path), as_json=as_json)
        wrote(out, "mr, tracker")


def _motion(name: str) -> "Motion":
    """The motion of that name; an unknown one is refused here, before anything is computed."""
    from data_synth import MOTIONS
    from dvf_ig.core import InvalidInputError

    for known in MOTIONS:
        if known == name:
            return known
    raise InvalidInputError(f"there is no motion '{name}'; choose from {', '.join(MOTIONS)}")


def _on_the_phantom(spec: "ScenarioSpec") -> "Scenario":
    from data_synth import phantom_scenario

    with progress("synthetic scenario") as report:
        return phantom_scenario(spec, report)


def _on_real_anatomy(
    spec: "ScenarioSpec", surfaces: Path, ecg: str, probe_path: Path
) -> "tuple[Scenario, ReplayedPath]":
    """Read the real recordings and simulate the ultrasound between them."""
    from data_synth import replayed_path, surface_scenario
    from dvf_ig.io import read_beat_annotations, read_ecg, read_sequence, read_surface_series

    beats_s = read_beat_annotations(ecg)
    signal = read_ecg(ecg)
    sequence = read_sequence(probe_path)
    fixed = "reference" if any("reference" in name for name in sequence.poses) else "tracker"
    path = replayed_path(sequence.stream(fixed, "probe"))
    present = _present_surfaces(surfaces)
    series = {name: read_surface_series(surfaces, name=name) for name in present}
    with progress("synthetic scenario") as report:
        return surface_scenario(spec, series, signal, beats_s, path, report), path


def _present_surfaces(folder: Path) -> list[str]:
    """The required surface, and those of the optional ones that the folder holds."""
    from dvf_ig.io import surface_names

    held = surface_names(folder)
    return [name for name in SURFACES if name == SURFACES[0] or name in held]


def _facts(made: "Scenario", out: Path, path: "ReplayedPath | None") -> dict[str, Any]:
    """What was made, as JSON."""
    truth = made.truth
    facts: dict[str, Any] = {
        "scenario": str(out),
        "name": made.name,
        "patient_id": made.preop.patient_id,
        "seed": made.seed,
        "us_frames": len(made.ultrasound),
        "ecg_seconds": len(made.ecg) / made.ecg.rate_hz,
        "preop_phases": len((made.preop.mr or made.preop.surfaces[0]).timing),
    }
    if truth is not None:
        facts["beats"] = len(truth.r_peaks_s)
        facts["mismatch_mm"] = truth.mismatch_mm
        facts["contact_share"] = float((truth.tool.distance_mm >= 0).mean())
        facts["deepest_mm"] = float(truth.tool.distance_mm.max())
    if path is not None:
        facts["probe_path"] = {"extent_mm": path.extent_mm, "extent_deg": path.extent_deg}
    return facts


def _rows(made: "Scenario", path: "ReplayedPath | None") -> list[tuple[str, str]]:
    """What was made, as a table."""
    facts = _facts(made, Path(), path)
    rows = [
        ("scenario", made.name),
        ("patient", made.preop.patient_id),
        ("pre-operative phases", str(facts["preop_phases"])),
        ("ECG", f"{facts['ecg_seconds']:.1f} s at {made.ecg.rate_hz:g} Hz"),
        ("ultrasound", f"{facts['us_frames']} frames"),
    ]
    if made.truth is not None:
        touching = f"{100 * facts['contact_share']:.0f} %, deepest {facts['deepest_mm']:.2f} mm"
        rows += [
            ("true beats", str(facts["beats"])),
            ("anatomy mismatch", f"{facts['mismatch_mm']:.2f} mm RMS"),
            ("tool in contact", touching),
        ]
    if path is not None:
        extent = f"{path.extent_mm:.1f} mm and {path.extent_deg:.1f}°, {path.t_s[-1]:.1f} s one way"
        rows.append(("recorded probe path", extent))
    return rows
