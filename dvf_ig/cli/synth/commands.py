"""`dvf-ig synth`: synthetic recordings with their truth."""

import threading
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from dvf_ig.cli.shell import command, warn

from .calibration import calibration
from .scenario import scenario
from .ultrasound import us

WAIT_S = 0.05


def stream(
    scenario: Annotated[Path, Argument(help="Scenario folder (see `dvf-ig synth scenario`).")],
    port: Annotated[
        int, Option(min=0, max=65535, help="Port to listen at, on this machine; 0 takes a free one.")
    ] = 18944,
    speed: Annotated[float, Option(min=0.01, max=100.0, help="Recorded seconds a second.")] = 1.0,
) -> None:
    """Wait for `dvf-ig serve` (or another client) on this machine, and send it a recording once.

    Device names as in PLUS: ProbeToTracker and ToolToTracker (TRANSFORM), Image_Tracker (IMAGE),
    EcgData (STRING). Stamps are the recording's, shifted to now. The truth is not sent.
    """
    with command(lists_inputs=False):
        import time

        from dvf_ig.intake import read_scenario
        from dvf_ig.live.link import listen
        from dvf_ig.live.player import play

        recorded = read_scenario(scenario, truth=False)
        with listen("127.0.0.1", port, None) as link:
            typer.echo(f"listening at 127.0.0.1:{link.port}", err=True)
            try:
                while not link.peers:
                    time.sleep(WAIT_S)
                first_s = min(float(recorded.ecg.t_s[0]), float(recorded.ultrasound.t_s[0]))
                origin_s = time.time() - first_s
                sent = play(recorded, link, speed=speed, origin_s=origin_s, stop=threading.Event())
            except KeyboardInterrupt:
                typer.echo("ending", err=True)
                return
            typer.echo(f"sent {sent} messages", err=True)
            if link.dropped:
                warn(f"{link.dropped} messages were dropped because the peer did not read them in time")


app = typer.Typer(no_args_is_help=True, help="Make synthetic recordings with known truth.")
app.command("calibration")(calibration)
app.command("us")(us)
app.command("scenario")(scenario)
app.command("stream")(stream)


@app.callback()
def synth() -> None:
    """Make synthetic recordings with known truth."""
