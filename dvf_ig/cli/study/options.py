"""Options that several studies share."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from dvf_ig.cli.shell import output_dir


class MotionName(StrEnum):
    """Motion presets."""

    paper5mm = "paper5mm"
    physiological = "physiological"


WorkersOption = Annotated[
    int | None, typer.Option("--workers", min=1, help="Processes (default: one for each core).")
]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", help="Work on this dask.distributed scheduler instead (tcp://HOST:8786)."),
]
FolderOption = Annotated[
    Path,
    typer.Option(
        "-o", "--out", callback=output_dir, help="Folder; a study that was stopped goes on where it was."
    ),
]
SeedsOption = Annotated[
    int,
    typer.Option("--seeds", min=1, help="How many seeds, counted up from --seed; one trial or heart each."),
]
FirstSeedOption = Annotated[int, typer.Option("--seed", help="The first seed.")]

RENAMED = {"--pairs": "--seeds", "--trials": "--seeds"}


class TrialsCommand(TyperCommand):
    """A study of many trials; it tells users of an earlier option its new name."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        for name in (arg.partition("=")[0] for arg in args):
            if name in RENAMED:
                raise typer.BadParameter(f"{name} is now called {RENAMED[name]}", ctx=ctx)
        return super().parse_args(ctx, args)
