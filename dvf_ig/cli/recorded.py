"""Options for a recording or a model that was moved since a folder of results named it."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

RecordingOption = Annotated[
    Path | None,
    Option("--recording", help="The recording, if it was moved: scenario folder, session.yaml or LOG.mcap."),
]
ModelOption = Annotated[Path | None, Option("--model", help="The patient's model, if its file was moved.")]


def require_place(what: str, place: Path, run: Path, option: str) -> None:
    """Refuse a file or folder that a run names and that is not there.

    Raises:
        typer.BadParameter: says where it was looked for, and the option that names it.
    """
    if not place.exists():
        raise typer.BadParameter(
            f"the {what} that {run} names is not at {place}; say where it is with {option}"
        )
