"""`dvf-ig calibrate`: one module for each of its commands."""

import typer

from .device import device
from .hand_eye import hand_eye
from .landmarks import landmarks
from .latency import latency
from .pivot import pivot
from .probe import probe

app = typer.Typer(
    help="Tool tip, image calibration, video lag, landmarks, hand-eye, haptic device.", no_args_is_help=True
)
app.command("probe")(probe)
app.command("landmarks")(landmarks)
app.command("hand-eye")(hand_eye)
app.command("pivot")(pivot)
app.command("latency")(latency)
app.command("device")(device)
