"""`dvf-ig synth scenario`: one synthetic intervention with its truth."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dvf_ig.cli.shell import JsonFlag, ThreadsOption, command, emit, progress, wrote

if TYPE_CHECKING:
    from data_synth import ReplayedPath, ScenarioSpec
    from dvf_ig.core import Scenario

    from .spec import SpecFile

SURFACES = ("EPICARDIAL", "LV_ENDOCARDIAL", "RV_ENDOCARDIAL")
"""Read from --surfaces; all but the first where present."""

PRESET_NAMES = (
    "calm, tachycardia, ectopy, line-of-sight-loss, probe-slip, patient-shift, poor-image, "
    "wrong-calibration, lost-ultrasound, noise-ultrasound, black-ultrasound, frozen-ultrasound, frozen-tool, "
    "tool-clock-restart, late-ecg"
)
"""Written out: the synthetic world itself is loaded only where a scenario is made."""


class World(StrEnum):
    """Which synthetic world."""

    first = "first"
    second = "second"


class Quality(StrEnum):
    """Which part of its graded ranges the second world draws."""

    calm = "calm"
    poor_image = "poor-image"


class Anatomy(StrEnum):
    """Whose heart beats."""

    phantom = "phantom"
    surfaces = "surfaces"


def scenario(
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Scenario folder to write.")] = None,
    spec_file: Annotated[
        Path | None,
        typer.Option(
            "--spec", help="YAML that describes the scenario; options given here replace its values."
        ),
    ] = None,
    print_spec: Annotated[
        bool, typer.Option("--print-spec", help="Print the YAML of this scenario and make nothing.")
    ] = False,
    world: Annotated[
        World | None,
        typer.Option("--world", help="The first (default), or the second: other tables, only to report."),
    ] = None,
    quality: Annotated[
        Quality | None, typer.Option("--quality", help="Second world only: calm (default) or poor-image.")
    ] = None,
    anatomy: Annotated[
        Anatomy | None,
        typer.Option("--anatomy", help="The four-chamber phantom (default), or real surfaces."),
    ] = None,
    preset: Annotated[
        str | None, typer.Option("--preset", help=f"What is disturbed: {PRESET_NAMES} (default: calm).")
    ] = None,
    motion: Annotated[
        str | None, typer.Option("--motion", help="Phantom only: paper5mm (default) or physiological.")
    ] = None,
    heart: Annotated[
        str | None,
        typer.Option(
            "--heart", help="Phantom only: standard (default), varied, healthy, dilated or hypertrophic."
        ),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option("--seconds", help="Length of the live part (default: 60).")
    ] = None,
    surfaces: Annotated[
        Path | None, typer.Option("--surfaces", help="Folder of corresponding surfaces.")
    ] = None,
    ecg: Annotated[
        str | None, typer.Option("--ecg", help="Annotated ECG whose beats drive the heart: wfdb:RECORD.")
    ] = None,
    probe_path: Annotated[
        Path | None, typer.Option("--probe-path", help="PLUS sequence whose probe motion is replayed.")
    ] = None,
    probe_calibration: Annotated[
        Path | None,
        typer.Option(
            "--probe-calibration",
            help="A real probe's ImageToProbe (PLUS XML, or JSON of `calibrate probe`) to simulate.",
        ),
    ] = None,
    image_px: Annotated[
        tuple[int, int] | None,
        typer.Option("--image-px", metavar="COLUMNS ROWS", help="Image size of --probe-calibration."),
    ] = None,
    mismatch_mm: Annotated[
        float | None, typer.Option("--mismatch-mm", help="RMS difference between MR and ultrasound anatomy.")
    ] = None,
    us_rate_hz: Annotated[
        float | None, typer.Option("--us-rate-hz", help="Ultrasound frames a second (default: 12).")
    ] = None,
    as_json: JsonFlag = False,
    seed: Annotated[
        int | None, typer.Option("--seed", help="Seed of every random choice (default: 1).")
    ] = None,
    anatomy_seed: Annotated[
        int | None, typer.Option("--anatomy-seed", help="Take the phantom's shape from this --seed.")
    ] = None,
    motion_seed: Annotated[
        int | None, typer.Option("--motion-seed", help="Take the phantom's pump function from this --seed.")
    ] = None,
    mismatch_seed: Annotated[
        int | None,
        typer.Option("--mismatch-seed", help="Take the difference between MR and now from this --seed."),
    ] = None,
    speckle_seed: Annotated[
        int | None, typer.Option("--speckle-seed", help="Take the ultrasound's speckle from this --seed.")
    ] = None,
    threads: ThreadsOption = None,
) -> None:
    """Simulate one intervention: pre-operative data, calibration recordings, ECG, ultrasound, tool, truth.

    The same options and seed give bit-identical recordings. With --anatomy surfaces the heart, its motion,
    the ECG and the hand motion are real; only the ultrasound is simulated. Truth, and the YAML from which
    the scenario can be made again, go to OUT/truth.
    """
    with command(threads):
        from data_synth import describe_faults
        from dvf_ig.io import ScenarioNotes, write_scenario
        from dvf_ig.report import preview_png

        from .spec import scenario_spec, spec_text

        given = {
            "world": None if world is None else world.value,
            "quality": None if quality is None else quality.value,
            "anatomy": None if anatomy is None else anatomy.value,
            "surfaces": None if surfaces is None else str(surfaces),
            "ecg": ecg,
            "probe_path": None if probe_path is None else str(probe_path),
            "probe_calibration": None if probe_calibration is None else str(probe_calibration),
            "image_px": image_px,
            "preset": preset,
            "motion": motion,
            "seconds": seconds,
            "seed": seed,
            "heart": heart,
            "anatomy_seed": anatomy_seed,
            "motion_seed": motion_seed,
            "mismatch_seed": mismatch_seed,
            "speckle_seed": speckle_seed,
            "us_rate_hz": us_rate_hz,
            "mismatch_mm": mismatch_mm,
        }
        file = _with_options(spec_file, given)
        if file.world == "second" or file.quality is not None:
            from .second_world import second_scenario

            second_scenario(file, out, print_spec=print_spec, as_json=as_json)
            return
        spec = scenario_spec(file)
        if print_spec:
            print(spec_text(file), end="")
            return
        if out is None:
            raise typer.BadParameter("give a folder to write with -o, or --print-spec")
        made, path = _made(file, spec)
        notes = ScenarioNotes(describe_faults(spec.options), spec_text(file), preview_png(made))
        write_scenario(made, out, notes)
        emit(_facts(made, out, path), _rows(made, path), as_json=as_json)
        wrote(out, "mr, tracker")


def _with_options(spec_file: Path | None, given: dict[str, Any]) -> "SpecFile":
    """The file (or the defaults), with the options that were given in place of its values."""
    from .spec import SpecFile, read_spec

    if spec_file is not None and given["preset"] is not None:
        raise typer.BadParameter("--preset and --spec both say what is wrong; change it in the file")
    file = read_spec(spec_file) if spec_file is not None else SpecFile()
    return file.model_copy(update={key: value for key, value in given.items() if value is not None})


def _made(file: "SpecFile", spec: "ScenarioSpec") -> "tuple[Scenario, ReplayedPath | None]":
    inputs = (file.surfaces, file.ecg, file.probe_path)
    if file.anatomy == "phantom":
        if any(given is not None for given in inputs):
            raise typer.BadParameter("--surfaces, --ecg and --probe-path belong to --anatomy surfaces")
        return _on_the_phantom(spec), None
    surfaces, ecg, probe_path = inputs
    if surfaces is None or ecg is None or probe_path is None:
        raise typer.BadParameter("--anatomy surfaces needs --surfaces, --ecg and --probe-path")
    return _on_real_anatomy(spec, Path(surfaces), ecg, Path(probe_path))


def _on_the_phantom(spec: "ScenarioSpec") -> "Scenario":
    from data_synth import phantom_scenario

    with progress("synthetic scenario") as report:
        return phantom_scenario(spec, report)


def _on_real_anatomy(
    spec: "ScenarioSpec", surfaces: Path, ecg: str, probe_path: Path
) -> "tuple[Scenario, ReplayedPath]":
    """Read the real recordings and simulate the ultrasound between them."""
    from data_synth import replayed_path, surface_scenario
    from dvf_ig.io import read_annotations, read_ecg, read_sequence, read_surface_series

    beats_s = read_annotations(ecg).t_s
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
    from dvf_ig.core import Signal

    truth, ecg = made.truth, made.ecg
    facts: dict[str, Any] = {
        "scenario": str(out),
        "name": made.name,
        "preset": made.preset,
        "patient_id": made.preop.patient_id,
        "seed": made.seed,
        "us_frames": len(made.ultrasound),
        "ecg_seconds": len(ecg) / ecg.rate_hz if isinstance(ecg, Signal) else float(ecg.t_s[-1]),
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
        ("ECG", f"{facts['ecg_seconds']:.1f} s"),
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
