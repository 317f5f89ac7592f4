"""`dvf-ig train`: play the tasks of Ren 2008 with a haptic device, with and without its force."""

from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from dvf_ig.cli.shell import JsonFlag, command, emit, out_folder, wrote


def train(
    task: Annotated[
        Literal["cutting", "dissection"],
        Argument(help="cutting: push pellets 5 mm deep; dissection: remove pellets above the organ."),
    ],
    device: Annotated[
        str, Option(help="force-dimension, openhaptics, simulated[:premium|:omni].")
    ] = "simulated",
    out: Annotated[Path, out_folder("Folder; earlier trials there stay.")] = Path("training"),
    person: Annotated[str | None, Option(help="Name in the tables (default: the device).")] = None,
    trials: Annotated[int, Option(min=1, help="Trials with and without force, each.")] = 1,
    sight: Annotated[Literal["mono", "side-by-side", "anaglyph"], Option(help="Depth in the page.")] = "mono",
    seed: Annotated[int, Option(help="Draws pellets, fulcra and the order of trials.")] = 1,
    page: Annotated[int, Option(min=0, max=65535, help="Port of the page; 0 takes a free one.")] = 0,
    as_json: JsonFlag = False,
) -> None:
    """Play a task of Ren 2008 on a beating heart with and without force, seen in a page of this machine.

    The order is drawn by the seed. A simulated device plays by itself. Trials are added to OUT/trials.jsonl;
    the table of all persons in OUT has the paper's rows as well (Table I; Tables III and IV).
    """
    with command():
        from dvf_ig.guidance.devices import open_device
        from dvf_ig.live.page import PageServer
        from dvf_ig.live.priority import answering_soon
        from dvf_ig.study.operators.closed_loop import operating_heart
        from dvf_ig.study.operators.practice import LOG, Practice, TrainingFeed, practise, read_log
        from dvf_ig.study.operators.tables import training_tables

        open_device(device).close()  # one that is missing is named before anything else
        practice = Practice(task, device, person or device, seed, trials, sight)
        out.mkdir(parents=True, exist_ok=True)
        typer.echo("preparing the beating heart (half a minute)", err=True)
        feed = TrainingFeed(operating_heart(), practice)
        with PageServer(feed, page) as server, answering_soon():
            typer.echo(f"see it at http://127.0.0.1:{server.port}", err=True)
            practise(operating_heart(), practice, feed, lambda text: typer.echo(text, err=True), out)
        lines = read_log(out)
        emit({"trials": lines}, training_tables(task, lines), as_json=as_json)
        wrote(out / LOG)
