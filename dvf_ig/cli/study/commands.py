"""`dvf-ig study`: many trials with a known truth; one JSON line each, and what they say together."""

import typer

from .blending import blending
from .calibration import calibration
from .constants import constants
from .distance import distance_maps
from .gating import gating
from .hearts import hearts
from .options import TrialsCommand
from .registration import add_registration_commands
from .replay import replay
from .retiming import retiming
from .stylus import tracking
from .training import training

app = typer.Typer(help="Many trials with a known truth.", no_args_is_help=True)
app.command("tracking")(tracking)
app.command("distance")(distance_maps)
app.command("blending")(blending)
app.command("gating")(gating)
app.command("retiming")(retiming)
app.command("training")(training)
app.command("replay")(replay)
app.command("hearts")(hearts)
app.command("constants")(constants)
add_registration_commands(app)
app.command("calibration", cls=TrialsCommand)(calibration)
