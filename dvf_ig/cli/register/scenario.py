"""`dvf-ig register SCENARIO`: mr_from_tracker from a recording's gated, tracked frames."""

from pathlib import Path

import typer

from dvf_ig.cli.patient_model import patient_model
from dvf_ig.cli.shell import progress

from .output import Registered


def register_recording(folder: Path, model: Path | None, init: Path | None, seed: int) -> Registered:
    from dvf_ig.io import read_scenario, read_transform
    from dvf_ig.replay import register_scenario
    from dvf_ig.replay.registration_inputs import frames_shown
    from dvf_ig.replay.start import start_pose

    given = read_transform(init, target="mr", source="tracker") if init is not None else None
    recorded = read_scenario(folder)
    start = given or start_pose(recorded)
    built, origin = patient_model(recorded.preop, model)
    with progress("register") as report:
        done = register_scenario(recorded, start, model=built, seed=seed, progress=report)
    typer.echo(origin, err=True)
    return Registered(done.result, start, frames_shown(done, recorded.name, recorded.preop.mr))
