"""`dvf-ig register` on tracked ultrasound: mr_from_tracker from a recording's gated frames."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from dvf_ig.cli.agreement import require_agreement
from dvf_ig.cli.patient_model import patient_model
from dvf_ig.cli.shell import progress

from .output import Registered

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel, Rigid, Scenario
    from dvf_ig.intake.read import SessionRecordings


def register_folder(folder: Path, model: Path | None, start: Path | None, seed: int) -> Registered:
    """A scenario folder, from its own start unless another is given."""
    from dvf_ig.intake.read import SessionRecordings
    from dvf_ig.intake.scenario.read import read_scenario
    from dvf_ig.io import read_transform

    given = None if start is None else read_transform(start, target="mr", source="tracker")
    recorded = read_scenario(folder)
    if given is not None:
        recorded = replace(recorded, start=given)
    require_agreement(SessionRecordings(recorded, None, None, None), "register")
    return _register(recorded, given, *patient_model(recorded.preop, model), seed)


def register_own(recordings: "SessionRecordings", seed: int) -> Registered:
    """A lab's own recordings, from the start that they name."""
    scenario = recordings.scenario
    return _register(scenario, None, *patient_model(scenario.preop, recordings.model), seed)


def _register(
    recorded: "Scenario", start: "Rigid | None", model: "DvfModel", origin: str, seed: int
) -> Registered:
    from dvf_ig.replay import register_scenario
    from dvf_ig.replay.page.registration_inputs import frames_shown

    with progress("register") as report:
        done = register_scenario(recorded, start, model=model, seed=seed, progress=report)
    typer.echo(origin, err=True)
    shown = replace(frames_shown(done, recorded.name, recorded.preop.mr), targets=recorded.landmarks_mr)
    return Registered(done.result, done.start, shown, recorded.tracked_against)
