"""`dvf-ig export rerun`: a recording of the Rerun viewer."""

from pathlib import Path
from typing import Annotated

import typer

from dvf_ig.cli.recorded import ModelOption, RecordingOption
from dvf_ig.cli.shell import JsonFlag, command, emit, output_file, wrote

from .source import RunArgument, read_source


def rerun(
    run: RunArgument,
    out: Annotated[Path, typer.Option("-o", "--out", callback=output_file, help="Recording to write, .rrd.")],
    recording: RecordingOption = None,
    model: ModelOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Write a replay as a recording of the Rerun viewer: heart, probe, ultrasound, tool, force, and curves.

    Needs pip install '.[rerun]' (0.7 GB). Frames are nested, in mm, LPS; time is the tracker's.
    """
    with command():
        from dvf_ig.replay.export.rerun_file import write_rerun
        from dvf_ig.replay.outputs import TICKS
        from dvf_ig.replay.run_folder import read_ticks

        if out.suffix != ".rrd":
            raise typer.BadParameter(f"-o is {out}; needed a name that ends in .rrd")
        exported, built, _ = read_source(run, recording, model)
        frames = write_rerun(exported, built, read_ticks(run / TICKS), out)
        result = {"file": str(out), "frames": frames}
        emit(result, [("ultrasound frames", str(frames))], as_json=as_json)
        wrote(out, "mr, tracker, probe, tool")
