"""`dvf-ig synth`: synthetic interventions with their truth."""

from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .shell import JsonFlag, SeedOption, ThreadsOption, command, emit, progress, wrote

if TYPE_CHECKING:
    from data_synth import ScenarioSpec
    from data_synth.probe_path import ReplayedPath
    from dvf_ig.core import Scenario, SurfaceSeries

app = typer.Typer(no_args_is_help=True, help="Make synthetic recordings with known truth.")

SURFACES = ("EPICARDIAL", "LV_ENDOCARDIAL", "RV_ENDOCARDIAL")
"""Read from --surfaces; all but the first where present."""


class Anatomy(str, Enum):
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
    real = {"--surfaces": surfaces, "--ecg": ecg, "--probe-path": probe_path}
    with command(threads):
        from data_synth import ScenarioSpec
        from dvf_ig.io import check_scenario_target, write_scenario

        check_scenario_target(out)
        spec = ScenarioSpec(preset, _motion(motion), seconds, seed, us_rate_hz, mismatch_mm)
        with progress("synthetic scenario") as report:
            if anatomy is Anatomy.phantom:
                _refuse(real, given=True, why="they belong to --anatomy surfaces")
                made, path = _phantom(spec, report), None
            else:
                _refuse(real, given=False, why="--anatomy surfaces needs them")
                made, path = _from_surfaces(spec, real, report)
        write_scenario(made, out)
        emit(_facts(made, out, path), _rows(made, path), as_json=as_json)
        wrote(out, "mr, tracker")
