"""`dvf-ig register SCENARIO`: mr_from_tracker from a recording's gated, tracked frames."""

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from dvf_ig.cli.patient_model import patient_model
from dvf_ig.cli.shell import progress

if TYPE_CHECKING:
    from .output import Registered


def register_recording(folder: Path, model: Path | None, init: Path | None, seed: int) -> "Registered":
    from dvf_ig.io import read_scenario, read_transform
    from dvf_ig.replay import register_scenario

    given = read_transform(init, target="mr", source="tracker") if init is not None else None
    recorded = read_scenario(folder)
    built, origin = patient_model(recorded.preop, model)
    with progress("register") as report:
        found = register_scenario(recorded, given, model=built, seed=seed, progress=report)
    typer.echo(origin, err=True)
    return found.result, found.start
