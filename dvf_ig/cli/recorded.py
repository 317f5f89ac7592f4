"""The recording that a folder of results names, wherever it stands now."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from dvf_ig.intake.read import SessionRecordings

RecordingOption = Annotated[
    Path | None,
    typer.Option(
        "--recording", help="The recording, if it was moved: scenario folder, SESSION.yaml or LOG.mcap."
    ),
]
ModelOption = Annotated[
    Path | None, typer.Option("--model", help="The patient's model, if its file was moved.")
]


def require_place(what: str, place: Path, run: Path, option: str) -> None:
    """Refuse a file or folder that a run names and that is not there.

    Raises:
        typer.BadParameter: says where it was looked for, and the option that names it.
    """
    if not place.exists():
        raise typer.BadParameter(
            f"the {what} that {run} names is not at {place}; say where it is with {option}"
        )


def read_recording(source: Path) -> "SessionRecordings":
    """A scenario folder, a SESSION.yaml, or a session's log."""
    from dvf_ig.intake.read import SessionRecordings, read_session
    from dvf_ig.intake.scenario.read import read_scenario

    if source.suffix == ".mcap" and source.is_file():
        from dvf_ig.replay.export.session_log_read import read_session_log

        return read_session_log(source)
    if source.is_dir():
        return SessionRecordings(read_scenario(source), None, None, None)
    return read_session(source)
