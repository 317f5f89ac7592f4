"""`dvf-ig serve`: a live session with PLUS or 3D Slicer."""

import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.cli.fixture_options import (
    BlendOption,
    CapOption,
    DeltaOption,
    DepthOption,
    ExponentOption,
    FixturesFileOption,
    GammaOption,
    InsideOption,
    LawOption,
    MarginOption,
    RetimingOption,
    chosen_fixtures,
    chosen_retiming,
    refuse_options,
    with_margin,
)
from dvf_ig.cli.shell import JsonFlag, SeedOption, ThreadsOption, command, emit, warn

from .setup import live_setup, read_patient

if TYPE_CHECKING:
    from dvf_ig.io.session_file.live import LiveConfig
    from dvf_ig.live.loop import LiveLoop

SWITCH_S = 0.001
"""A thread of ours that waits for the interpreter gets it after this, not after the usual 5 ms."""


def serve(
    config: Annotated[
        Path,
        typer.Option(
            "--config",
            help="SESSION.yaml with a section 'live' (see the guide, live link), or a scenario folder whose "
            "recording `dvf-ig synth stream` sends.",
        ),
    ],
    model: Annotated[
        Path | None, typer.Option("--model", help="This patient's model, if `dvf-ig model build` made one.")
    ] = None,
    host: Annotated[
        str | None,
        typer.Option(
            "--host", help="PLUS or Slicer; as a server, the address to listen at.", show_default="127.0.0.1"
        ),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(
            "--port",
            min=0,
            max=65535,
            help="Its port; as a server, 0 takes a free one.",
            show_default="18944",
        ),
    ] = None,
    listen: Annotated[
        bool, typer.Option("--listen", help="Be the server that PLUS or Slicer connects to.")
    ] = False,
    allow: Annotated[
        list[str] | None,
        typer.Option("--allow", help="Address of another machine that poses may come from; may be repeated."),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option("--seconds", min=0.1, help="End after so long (default: Ctrl-C).")
    ] = None,
    law: LawOption = None,
    gamma: GammaOption = None,
    delta: DeltaOption = None,
    m: ExponentOption = None,
    cap_n: CapOption = None,
    depth_mm: DepthOption = None,
    inside: InsideOption = False,
    blend: BlendOption = None,
    fixtures: FixturesFileOption = None,
    retiming: RetimingOption = None,
    margin: MarginOption = None,
    as_json: JsonFlag = False,
    seed: SeedOption = 0,
    threads: ThreadsOption = None,
) -> None:
    """Take poses, ultrasound and ECG from PLUS or 3D Slicer (OpenIGTLink), and send back pose and force.

    Sends MrFromTracker and ToolForce (TRANSFORM, at most 60 a second), DvfIg (STATUS) and DvfIgState (STRING).
    Other machines are refused unless --allow names them. At the end latency and counts are printed. In a
    terminal, r and Enter re-arms after a latch; the network never does.
    """
    with command(threads):
        patient = read_patient(config)
        given = {"law": law, "gamma": gamma, "delta": delta, "m": m, "cap_n": cap_n, "depth_mm": depth_mm}
        given |= {"inside": inside, "blend": blend}
        options, of_file = chosen_fixtures(given, fixtures)
        if patient.fixtures is not None:
            refuse_options(given, fixtures)
            options = patient.fixtures
        mode = chosen_retiming(retiming, patient.retiming or of_file)
        changes = {"host": host, "port": port, "role": "server" if listen else None}
        changes["allow"] = None if not allow else (*patient.live.allow, *allow)
        live = patient.live.model_copy(update={key: v for key, v in changes.items() if v is not None})
        setup, landmarks, origin = live_setup(patient, model, with_margin(options, margin), mode, seed)
        typer.echo(origin, err=True)

        from dvf_ig.live.serve import LiveOptions, live_session
        from dvf_ig.live.summary import LiveSummary

        summary = LiveSummary()
        running = LiveOptions(live, landmarks=landmarks, observe=summary.add, tell=warn)
        with live_session(setup, running) as loop:
            _tell_where(live, loop)
            _run(loop, seconds)
            result = summary.result(loop)
        emit(result, summary.table(result), as_json=as_json)


def _tell_where(live: "LiveConfig", loop: "LiveLoop") -> None:
    where = f"{live.host}:{loop.link.port or live.port}"
    typer.echo(f"listening at {where}" if live.role == "server" else f"connecting to {where}", err=True)
    if not loop.servo.realtime:
        warn("this machine gives the servo no real-time priority; under load it may latch for being late")


def _run(loop: "LiveLoop", seconds: float | None) -> None:
    """Until the time is over, or Ctrl-C."""
    from dvf_ig.live.serve import run_in_thread

    sys.setswitchinterval(SWITCH_S)
    if sys.stdin.isatty():
        threading.Thread(target=_watch_keys, args=(loop,), daemon=True).start()
    thread, stop = run_in_thread(loop)
    try:
        thread.join(seconds)
    except KeyboardInterrupt:
        typer.echo("ending", err=True)
    stop.set()
    thread.join()


def _watch_keys(loop: "LiveLoop") -> None:
    for line in sys.stdin:
        if line.strip().lower() == "r":
            loop.ask_rearm()
