"""`dvf-ig`: parse, call, print; nothing else. Each command is one file of this folder."""

import os
import sys
from typing import Annotated

import typer
from typer import Option

import dvf_ig
from dvf_ig.cli import (
    bench,
    cache,
    config,
    device,
    doctor,
    evaluate,
    export,
    force,
    gate,
    replay,
    study,
    train,
    view,
)
from dvf_ig.cli.calibrate import commands as calibrate
from dvf_ig.cli.examples import show_examples
from dvf_ig.cli.inspect import command as inspect
from dvf_ig.cli.model import commands as model
from dvf_ig.cli.register import command as register
from dvf_ig.cli.serve import command as serve
from dvf_ig.cli.session_argument import SessionCommand
from dvf_ig.cli.shell import Program, report_unexpected
from dvf_ig.cli.synth import commands as synth

INTERRUPTED = 130
"""Exit code after Ctrl-C, as a shell gives it."""

app = typer.Typer(
    name="dvf-ig",
    cls=Program,
    help="Dynamic virtual fixtures for beating-heart intervention: from raw OR streams to a haptic force.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

app.command("doctor")(doctor.doctor)
app.command("cache")(cache.cache)
app.command("inspect")(inspect.inspect)
app.add_typer(synth.app, name="synth")
app.add_typer(model.app, name="model")
app.command("force")(force.force)
app.add_typer(calibrate.app, name="calibrate")
app.command("gate")(gate.gate)
app.command("register", cls=SessionCommand)(register.register)
app.command("evaluate")(evaluate.evaluate)
app.command("replay", cls=SessionCommand)(replay.replay)
app.command("serve", cls=SessionCommand)(serve.serve)
app.add_typer(device.app, name="device")
app.command("train")(train.train)
app.command("view")(view.view)
app.add_typer(export.app, name="export")
app.add_typer(config.app, name="config")
app.add_typer(study.app, name="study")
app.command("bench")(bench.bench)
show_examples(app)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"dvf-ig {dvf_ig.__version__}")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool, Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Exit codes: 0 ok, 2 usage, 3 bad input, 4 cannot write, 5 no overlap, 6 not converged, 7 quality gate
    failed, 8 partial batch, 70 a fault of this program, 130 interrupted."""


def run() -> None:
    """Entry point of the `dvf-ig` command; an unexpected exception ends it with exit code 70.

    After Ctrl-C (exit code 130) it does not wait for threads that still compute.

    OpenBLAS gets one thread, where the user has not said otherwise: our matrices are small, our kernels use
    all cores themselves, and waking its threads costs a registration 0.1 s and the odd step 98 ms.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        app()
    except SystemExit as end:
        if end.code == INTERRUPTED:
            typer.echo("interrupted", err=True)
            sys.stdout.flush()
            os._exit(INTERRUPTED)
        raise
    except Exception as error:  # noqa: BLE001  the edge: whatever was not foreseen ends in a sentence
        sys.exit(report_unexpected(error))
