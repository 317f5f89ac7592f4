"""`dvf-ig export`: recordings and results for other programs."""

import typer

from .mcap import mcap
from .rerun import rerun
from .slicer import slicer

app = typer.Typer(help="Write a run or a registration for other programs.", no_args_is_help=True)
app.command("slicer")(slicer)
app.command("mcap")(mcap)
app.command("rerun")(rerun)
