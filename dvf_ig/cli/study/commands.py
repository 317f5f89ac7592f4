"""`dvf-ig study`: many trials with a known truth; one JSON line each, and what they say together."""

import typer

from .blending import blending
from .calibration import calibration
from .cines import cines
from .constants import constants
from .distance import distance_maps
from .faults import faults
from .gating import gating
from .hearts import hearts
from .live import live
from .margins import margins
from .messages import messages
from .operators import operators
from .options import TrialsCommand
from .pairs import pairs
from .passivity import passivity
from .registration import add_registration_commands
from .replay import replay
from .retiming import retiming
from .stylus import tracking
from .training import training
from .watch import watch

app = typer.Typer(help="Many trials with a known truth.", no_args_is_help=True)
app.command("tracking")(tracking)
app.command("distance")(distance_maps)
app.command("cines")(cines)
app.command("blending")(blending)
app.command("gating")(gating)
app.command("retiming")(retiming)
app.command("training")(training)
app.command("replay")(replay)
app.command("live")(live)
app.command("messages")(messages)
app.command("hearts")(hearts)
app.command("constants")(constants)
app.command("margins")(margins)
app.command("watch")(watch)
add_registration_commands(app)
app.command("calibration", cls=TrialsCommand)(calibration)
app.command("pairs")(pairs)
app.command("passivity")(passivity)
app.command("faults")(faults)
app.command("operators")(operators)
