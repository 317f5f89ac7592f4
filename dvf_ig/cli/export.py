"""`dvf-ig export`: a run or a registration, with its recording, for 3D Slicer, ROS 2 tools and Rerun."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer
from typer import Argument

from .recorded import ModelOption, RecordingOption, require_place
from .session_argument import patient_model
from .shell import JsonFlag, SeedOption, command, emit, out_file, out_folder, wrote

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel
    from dvf_ig.replay.export.exported_run import ExportedRun

app = typer.Typer(help="Write a run or a registration for other programs.", no_args_is_help=True)

RunArgument = Annotated[Path, Argument(metavar="RUN", help="Folder that `dvf-ig replay` wrote.")]


class Source(NamedTuple):
    """Source of an export: the run, the patient's model, and that model if a file gave it."""

    run: "ExportedRun"
    model: "DvfModel"
    given: "DvfModel | None"


def read_source(run: Path, recording: Path | None, model: Path | None) -> Source:
    """Read the run with its recording, which a replay names and a registration does not."""
    from dvf_ig.intake import read_session
    from dvf_ig.replay.export.exported_run import read_exported_run
    from dvf_ig.replay.view_file import VIEW, read_view_file

    named = read_view_file(run) if (run / VIEW).is_file() else None
    place = recording or (named.recording if named is not None else None)
    if place is None:
        raise typer.BadParameter(
            f"{run} does not name its recording; name it with --recording FOLDER or session.yaml"
        )
    require_place("recording", place, run, "--recording FOLDER or session.yaml")
    file = model or (named.model if named is not None else None)
    if file is not None:
        require_place("model", file, run, "--model FILE")
    files = read_session(place)
    exported = read_exported_run(run, files.scenario)
    given = files.model or file
    built, _ = patient_model(exported.scenario.preop, given)
    return Source(exported, built, None if given is None else built)


@app.command("slicer")
def slicer(
    run: Annotated[
        Path, Argument(metavar="RUN", help="Folder that `dvf-ig replay` or `dvf-ig register` wrote.")
    ],
    out: Annotated[Path, out_folder("Folder to write; an earlier one of dvf-ig is replaced.")],
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


@app.command("mcap")
def mcap(
    run: RunArgument,
    out: Annotated[Path, out_file("Log to write, .mcap.")],
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


@app.command("rerun")
def rerun(
    run: RunArgument,
    out: Annotated[Path, out_file("Recording to write, .rrd.")],
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
