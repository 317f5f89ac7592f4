"""`dvf-ig synth`: synthetic recordings with their truth."""

import typer

from .calibration import calibration
from .scenario import scenario
from .stream import stream
from .ultrasound import us

app = typer.Typer(no_args_is_help=True, help="Make synthetic recordings with known truth.")
app.command("calibration")(calibration)
app.command("us")(us)
app.command("scenario")(scenario)
app.command("stream")(stream)


@app.callback()
def synth() -> None:
    """Make synthetic recordings with known truth."""
