"""Exported run, and its recording."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from dvf_ig.cli.patient_model import patient_model
from dvf_ig.cli.recorded import require_place

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel
    from dvf_ig.replay.export.exported_run import ExportedRun

RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="Folder that `dvf-ig replay` wrote.")]
RunOrRegistration = Annotated[
    Path, typer.Argument(metavar="RUN", help="Folder that `dvf-ig replay` or `dvf-ig register` wrote.")
]


class Source(NamedTuple):
    """Source of an export: the run, the patient's model, and that model if a file gave it."""

    run: "ExportedRun"
    model: "DvfModel"
    given: "DvfModel | None"


def read_source(run: Path, recording: Path | None, model: Path | None) -> Source:
    """Read the run with its recording, which a replay names and a registration does not."""
    from dvf_ig.intake import read_session
    from dvf_ig.replay.export.exported_run import read_exported_run
    from dvf_ig.replay.view_file import VIEW, read_view_file

    named = read_view_file(run) if (run / VIEW).is_file() else None
    place = recording or (named.recording if named is not None else None)
    if place is None:
        raise typer.BadParameter(
            f"{run} does not name its recording; name it with --recording FOLDER or session.yaml"
        )
    require_place("recording", place, run, "--recording FOLDER or session.yaml")
    file = model or (named.model if named is not None else None)
    if file is not None:
        require_place("model", file, run, "--model FILE")
    files = read_session(place)
    found = read_exported_run(run, files.scenario)
    given = files.model or file
    built, _ = patient_model(found.scenario.preop, given)
    return Source(found, built, None if given is None else built)
