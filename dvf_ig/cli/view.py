"""`dvf-ig view`: a replay as one HTML file that plays."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument

from .recorded import ModelOption, RecordingOption, require_place
from .session_argument import patient_model
from .shell import JsonFlag, ThreadsOption, command, emit, out_file, wrote


def view(
    run: Annotated[
        Path, Argument(metavar="RUN", help="Folder that `dvf-ig replay … -o RUN` wrote; or a model (.npz).")
    ],
    out: Annotated[
        Path | None, out_file("HTML file to write (default: RUN/view.html, or next to the model).")
    ] = None,
    recording: RecordingOption = None,
    model: ModelOption = None,
    as_json: JsonFlag = False,
    threads: ThreadsOption = None,
) -> None:
    """Write a replay, or a model, as one HTML file that plays in a browser, without a network.

    It shows the beating heart, ultrasound, tool, force and signals; its numbers are those of RUN/ticks.csv.
    """
    with command(threads):
        from dvf_ig.intake import read_session
        from dvf_ig.io import provenance_fields, require_outputs, write_text
        from dvf_ig.replay.run_folder import read_run, require_same_recording
        from dvf_ig.replay.view import run_payload
        from dvf_ig.report.viewer import viewer_html

        path = out or (run.with_suffix(".html") if run.suffix == ".npz" else run / "view.html")
        require_outputs(path)
        if run.suffix == ".npz":
            _view_model(run, path, as_json=as_json)
            return
        recorded = read_run(run)
        source = recording or recorded.view.recording
        require_place("recording", source, run, "--recording FOLDER or session.yaml")
        model = model or recorded.view.model
        if model is not None:
            require_place("model", model, run, "--model FILE")
        files = read_session(source)
        require_same_recording(recorded.result, run, provenance_fields()["inputs"])
        built, origin = patient_model(files.heart, files.model or model)
        payload = run_payload(recorded, files.scenario, built)
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
            ("page", f"{result['megabytes']:.1f} MB, {result['seconds']:.0f} s, {result['frames']} frames")
        ]
        emit(result, rows, as_json=as_json)
        typer.echo(origin, err=True)
        wrote(path)


def _view_model(model_file: Path, path: Path, *, as_json: bool) -> None:
    """Write a model's beating surfaces as one page."""
    from dvf_ig.io import read_model, write_text
    from dvf_ig.report.viewer import model_payload, viewer_html

    model = read_model(model_file)
    page = viewer_html(model_payload(model))
    write_text(path, page)
    megabytes = len(page.encode()) / 1e6
    result = {"file": str(path), "megabytes": round(megabytes, 3), "phases": model.phases}
    emit(result, [("page", f"{megabytes:.1f} MB, {model.phases} phases")], as_json=as_json)
    wrote(path, model.frame)
