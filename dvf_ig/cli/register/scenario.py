"""`dvf-ig register` on tracked ultrasound: mr_from_tracker from a recording's gated frames."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from dvf_ig.cli.agreement import require_agreement
from dvf_ig.cli.patient_model import patient_model
from dvf_ig.cli.shell import progress

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel, Scenario
    from dvf_ig.io import SessionRecordings
    from dvf_ig.registration import RegistrationResult
    from dvf_ig.replay.page.registration_page import ShownInput


def register_folder(
    folder: Path, model: Path | None, start: Path | None, seed: int
) -> "tuple[RegistrationResult, ShownInput]":
    """A scenario folder, from its own start unless another is given."""
    from dvf_ig.io import SessionRecordings, read_scenario, read_transform

    given = None if start is None else read_transform(start, target="mr", source="tracker")
    recorded = read_scenario(folder)
    if given is not None:
        recorded = replace(recorded, start=given)
    require_agreement(SessionRecordings(recorded, None, None, None), "register")
    return _register(recorded, *patient_model(recorded.preop, model), seed)


def register_own(recordings: "SessionRecordings", seed: int) -> "tuple[RegistrationResult, ShownInput]":
    """A lab's own recordings, from the start that they name."""
    scenario = recordings.scenario
    return _register(scenario, *patient_model(scenario.preop, recordings.model), seed)


def _register(
    recorded: "Scenario", model: "DvfModel", origin: str, seed: int
) -> "tuple[RegistrationResult, ShownInput]":
    from dvf_ig.replay.page.registration_inputs import frames_shown
    from dvf_ig.replay.registration import every_frame, recorded_ultrasound, register_recording

    with progress("register") as report:
        recording = recorded_ultrasound(
            recorded, model=model, seed=seed, progress=lambda share: report(0.6 * share)
        )
        frames = every_frame(recording)
        result = register_recording(
            recorded, recording, frames, seed=seed, progress=lambda share: report(0.6 + 0.4 * share)
        )
    typer.echo(origin, err=True)
    return result, frames_shown(result, frames, recording, recorded)
