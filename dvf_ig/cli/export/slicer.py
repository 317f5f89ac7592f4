"""`dvf-ig export slicer`: a folder that 3D Slicer opens."""

from pathlib import Path
from typing import Annotated

import typer

from dvf_ig.cli.recorded import ModelOption, RecordingOption
from dvf_ig.cli.shell import JsonFlag, command, emit, output_dir, wrote

from .source import RunOrRegistration, read_source


def slicer(
    run: RunOrRegistration,
    out: Annotated[
        Path,
        typer.Option(
            "-o", "--out", callback=output_dir, help="Folder to write; an earlier one of dvf-ig is replaced."
        ),
    ],
    recording: RecordingOption = None,
    model: ModelOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Write a run or a registration as a scene that 3D Slicer opens, each file also usable alone.

    MR, surfaces through the cycle, targets and landmarks; ultrasound, probe, tool and registration over time,
    nested as they were tracked. README.md in the folder describes how to load each file.
    """
    with command():
        from dvf_ig.io.writing.atomic import atomic_folder
        from dvf_ig.replay.export.slicer_scene import SCENE, write_slicer_scene

        exported, built, _ = read_source(run, recording, model)
        with atomic_folder(out) as new:
            frames = write_slicer_scene(exported, built, new)
        result = {"scene": str(out / SCENE), "files": frames}
        rows = [("scene", str(out / SCENE)), ("files", str(len(frames))), ("open", f"README.md in {out}")]
        emit(result, rows, as_json=as_json)
        for name, frame in frames.items():
            wrote(out / name, frame)
