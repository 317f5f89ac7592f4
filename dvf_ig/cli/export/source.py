"""The run that is exported, and the recording that it was made from."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from dvf_ig.cli.patient_model import patient_model

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel, Scenario
    from dvf_ig.replay.run_folder import RunFolder

RunArgument = Annotated[
    Path, typer.Argument(metavar="RUN", help="Folder that `dvf-ig replay` or `dvf-ig register` wrote.")
]
RecordingOption = Annotated[
    Path, typer.Option("--recording", help="Scenario folder or SESSION.yaml that RUN was made from.")
]
ModelOption = Annotated[
    Path | None, typer.Option("--model", help="The patient's model, where RUN was made with --model.")
]


class Source(NamedTuple):
    """What is exported."""

    run: "RunFolder"
    model: "DvfModel"
    given: "DvfModel | None"


def read_source(run: Path, recording: Path, model: Path | None) -> "Source":
    """The run with its recording, the patient's model, and that model where a file gave it."""
    from dvf_ig.io import SessionRecordings, read_scenario, read_session
    from dvf_ig.replay.run_folder import read_run

    read: list[SessionRecordings] = []

    def scenario() -> "Scenario":
        if recording.is_dir():
            read.append(SessionRecordings(read_scenario(recording), None, None, None))
        else:
            read.append(read_session(recording))
        return read[0].scenario

    found = read_run(run, scenario)
    built, _ = patient_model(found.scenario.preop, read[0].model or model)
    return Source(found, built, built if read[0].model is not None or model is not None else None)
