"""Options that several studies share."""

from pathlib import Path
from typing import Annotated

import typer

WorkersOption = Annotated[
    int | None, typer.Option("--workers", min=1, help="Processes (default: one for each core).")
]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", help="Work on this dask.distributed scheduler instead (tcp://HOST:8786)."),
]
FolderOption = Annotated[
    Path,
    typer.Option("-o", "--out", help="Folder; a study that was stopped goes on where it was."),
]
