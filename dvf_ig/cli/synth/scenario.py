"""`dvf-ig synth scenario`: one synthetic intervention with its truth."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer import Option

from dvf_ig.cli.shell import JsonFlag, ThreadsOption, VoxelOption, command, out_folder, voxel_size

if TYPE_CHECKING:
    from dvf_ig.cli.synth.spec import SpecFile


PRESET_NAMES = (
    "calm, tachycardia, ectopy, line-of-sight-loss, probe-slip, patient-shift, poor-image, "
    "wrong-calibration, lost-ultrasound, noise-ultrasound, black-ultrasound, frozen-ultrasound, frozen-tool, "
    "tool-clock-restart, late-ecg, tool-in-view, tool-elsewhere, tool-unseen, deformed, "
    "deformed-touched, other-motion, "
    "still-wall, ventilated, breathing, unrecorded-breathing, atrial"
)
"""Names written out, as the synthetic world is loaded only to make a scenario."""


def scenario(
    out: Annotated[Path | None, out_folder("Scenario folder to write.")] = None,
    spec_file: Annotated[
        Path | None,
        Option("--spec", help="YAML that describes the scenario; options given here replace its values."),
    ] = None,
    print_spec: Annotated[bool, Option("--print-spec", help="Only print the YAML of this scenario.")] = False,
    world: Annotated[
        Literal["first", "second"] | None,
        Option(help="The first (default), or the second: other tables, only for reports."),
    ] = None,
    quality: Annotated[
        Literal["calm", "poor-image"] | None, Option(help="Second world only: calm (default) or poor-image.")
    ] = None,
    anatomy: Annotated[
        Literal["phantom", "surfaces", "cine"] | None,
        Option(help="The four-chamber phantom (default), real surfaces, or the heart of a real cine."),
    ] = None,
    preset: Annotated[str | None, Option(help=f"Disturbance: {PRESET_NAMES} (default: calm).")] = None,
    motion: Annotated[str | None, Option(help="Phantom only: paper5mm (default) or physiological.")] = None,
    heart: Annotated[
        str | None, Option(help="Phantom only: standard (default), varied, healthy, dilated or hypertrophic.")
    ] = None,
    exam: Annotated[
        Literal["sax7", "sax8", "sax10", "sax+lax"] | None,
        Option(
            help="Phantom only: its MR as an examination: short-axis slices of 8 mm with gaps, the middle "
            "seven of them alone, slices of 10 mm, or with three long-axis cines (default: isotropic MR)."
        ),
    ] = None,
    seconds: Annotated[float | None, Option(help="Length of the live part (default: 60).")] = None,
    surfaces: Annotated[Path | None, Option(help="Folder of corresponding surfaces.")] = None,
    ecg: Annotated[str | None, Option(help="Annotated ECG whose beats drive the heart: wfdb:RECORD.")] = None,
    probe_path: Annotated[Path | None, Option(help="PLUS sequence whose probe motion is replayed.")] = None,
    cine: Annotated[Path | None, Option(help="Real 4-D short-axis MR, from end-diastole on.")] = None,
    labels: Annotated[
        Path | None, Option(help="Labels at end-diastole: 1 right ventricle, 2 myocardium, 3 left ventricle.")
    ] = None,
    es_labels: Annotated[
        str | None,
        Option(help="Labels at end-systole, FILE@PHASE (phase 0 is the first); else the cine is tracked."),
    ] = None,
    voxel_mm: VoxelOption = None,
    probe_calibration: Annotated[
        Path | None,
        Option(help="A real probe's ImageToProbe (PLUS XML, or JSON of `calibrate probe`) to simulate."),
    ] = None,
    image_px: Annotated[
        tuple[int, int] | None, Option(metavar="COLUMNS ROWS", help="Image size of --probe-calibration.")
    ] = None,
    mismatch_mm: Annotated[
        float | None, Option(help="RMS difference between MR and ultrasound anatomy.")
    ] = None,
    us_rate_hz: Annotated[float | None, Option(help="Ultrasound frames a second (default: 12).")] = None,
    as_json: JsonFlag = False,
    seed: Annotated[int | None, Option(help="Seed of every random choice (default: 1).")] = None,
    anatomy_seed: Annotated[int | None, Option(help="Take the phantom's shape from this --seed.")] = None,
    motion_seed: Annotated[
        int | None, Option(help="Take the phantom's pump function from this --seed.")
    ] = None,
    mismatch_seed: Annotated[
        int | None, Option(help="Take the difference between MR and now from this --seed.")
    ] = None,
    speckle_seed: Annotated[
        int | None, Option(help="Take the ultrasound's speckle from this --seed.")
    ] = None,
    threads: ThreadsOption = None,
) -> None:
    """Simulate one intervention: pre-operative data, calibration recordings, ECG, ultrasound, tool, truth.

    The same options and seed give bit-identical recordings. With --anatomy surfaces the heart, its motion,
    the ECG and the hand motion are real; only the ultrasound is simulated. With --anatomy cine the MR is
    real, and the heart that the ultrasound shows is built from the expert's labels. Truth, and the YAML from
    which the scenario can be made again, go to OUT/truth.
    """
    options = locals()
    with command(threads):
        from .first_world import first_scenario
        from .second_world import second_scenario

        file = _with_options(spec_file, {**options, "voxel_mm": voxel_size(voxel_mm)})
        second = file.world == "second" or file.quality is not None
        make = second_scenario if second else first_scenario
        make(file, out, print_spec=print_spec, as_json=as_json)


def _with_options(spec_file: Path | None, options: dict[str, Any]) -> "SpecFile":
    """Read the file (or the defaults), and replace its values by the options that were given."""
    from .spec import SpecFile, read_spec

    if spec_file is not None and options["preset"] is not None:
        raise typer.BadParameter("--preset and --spec both state the disturbances; change them in the file")
    file = read_spec(spec_file) if spec_file is not None else SpecFile()
    stated = {key: options[key] for key in SpecFile.model_fields if options.get(key) is not None}
    paths = {key: str(value) for key, value in stated.items() if isinstance(value, Path)}
    return file.model_copy(update=stated | paths)
