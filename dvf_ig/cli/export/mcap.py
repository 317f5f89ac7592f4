"""`dvf-ig export mcap`: the log of a session with ROS 2 messages."""

from pathlib import Path
from typing import Annotated

import typer

from dvf_ig.cli.recorded import ModelOption, RecordingOption
from dvf_ig.cli.shell import JsonFlag, SeedOption, command, emit, output_file, wrote

from .source import RunArgument, read_source


def mcap(
    run: RunArgument,
    out: Annotated[Path, typer.Option("-o", "--out", callback=output_file, help="Log to write, .mcap.")],
    recording: RecordingOption = None,
    model: ModelOption = None,
    seed: SeedOption = 0,
    as_json: JsonFlag = False,
) -> None:
    """Write the log of a session: ROS 2 messages in MCAP, which `dvf-ig replay LOG.mcap` replays bit by bit.

    Transforms (metres), images, ECG, force, phase and diagnostics for ros2 bag, Foxglove and PlotJuggler; the
    recorded numbers, calibrations and the heart for the replay. Needs pip install '.[log]'.
    """
    with command():
        from dvf_ig.replay.export.session_log import write_session_log

        if out.suffix != ".mcap":
            raise typer.BadParameter(f"-o is {out}; needed a name that ends in .mcap")
        exported, _, model_given = read_source(run, recording, model)
        messages = write_session_log(exported, run, out, given=model_given, seed=seed)
        megabytes = out.stat().st_size / 1e6
        result = {"file": str(out), "messages": messages, "megabytes": round(megabytes, 1)}
        emit(result, [("messages", str(messages)), ("size", f"{megabytes:.1f} MB")], as_json=as_json)
        wrote(out, "mr, tracker, probe, tool, image")
