"""`dvf-ig view`: a replay as one HTML file that plays."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .patient_model import patient_model
from .shell import JsonFlag, ThreadsOption, command, emit, wrote

if TYPE_CHECKING:
    from dvf_ig.io import SessionRecordings


def view(
    run: Annotated[Path, typer.Argument(help="Folder that `dvf-ig replay … -o RUN` wrote.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="HTML file to write (default: RUN/view.html).")
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option("--recording", help="The recording, if it was moved: scenario folder or SESSION.yaml."),
    ] = None,
    model: Annotated[
        Path | None, typer.Option("--model", help="The patient's model, if its file was moved.")
    ] = None,
    as_json: JsonFlag = False,
    threads: ThreadsOption = None,
) -> None:
    """Write a replay as one HTML file that plays in a browser, without a network: heart, ultrasound, tool, force.

    Every number that it shows is one of ticks.csv in RUN.
    """
    with command(threads):
        from dvf_ig.io import provenance_fields, refuse_foreign, write_text
        from dvf_ig.replay.run_folder import read_run
        from dvf_ig.replay.view import require_replayed, run_payload
        from dvf_ig.report.viewer import viewer_html

        path = out or run / "view.html"
        if out is None:
            refuse_foreign(path)
        recorded = read_run(run)
        source = recording or recorded.view.recording
        if not source.exists():
            raise typer.BadParameter(_moved("recording", source, run, "--recording FOLDER or SESSION.yaml"))
        model = model or recorded.view.model
        if model is not None and not model.is_file():
            raise typer.BadParameter(_moved("model", model, run, "--model FILE"))
        recordings = _read(source)
        require_replayed(recorded, provenance_fields()["inputs"], source)
        built, origin = patient_model(recordings.scenario.preop, recordings.model or model)
        payload = run_payload(recorded, recordings.scenario, built)
        page = viewer_html(payload)
        write_text(path, page)
        frames = payload["series"]["frames"]
        result = {
            "file": str(path),
            "megabytes": round(len(page.encode()) / 1e6, 3),
            "seconds": round(float(recorded.ticks["t_s"][-1] - recorded.ticks["t_s"][0]), 3),
            "frames": 0 if frames is None else len(frames["images"]),
        }
        rows = [
            ("page", f"{result['megabytes']:.1f} MB, {result['seconds']:.0f} s, {result['frames']} frames"),
        ]
        emit(result, rows, as_json=as_json)
        typer.echo(origin, err=True)
        wrote(path)


def _moved(what: str, place: Path, run: Path, option: str) -> str:
    return f"the {what} that {run} names is not at {place}; say where it is with {option}"


def _read(source: Path) -> "SessionRecordings":
    from dvf_ig.io import SessionRecordings, read_scenario, read_session

    return (
        SessionRecordings(read_scenario(source), None, None, None)
        if source.is_dir()
        else read_session(source)
    )
