"""`dvf-ig replay`: a recorded intervention from raw streams to force."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument

from . import fixture_options
from .run_outputs import run_files, write_run
from .session_argument import SESSION, ModelOption, patient_model, read_agreeing
from .shell import JsonFlag, SeedOption, ThreadsOption, command, emit, out_folder, progress, warn, wrote


@fixture_options.takes_fixture
def replay(
    out: Annotated[Path, out_folder("Folder for the result, its page, the pose and the ticks.")],
    session: Annotated[
        Path, Argument(metavar="SESSION", help=f"{SESSION.capitalize()}; or a session's LOG.mcap.")
    ],
    model: ModelOption = None,
    *,
    fixture: dict[str, Any],
    fixtures: fixture_options.FixturesFileOption = None,
    retiming: fixture_options.RetimingOption = None,
    margin: fixture_options.MarginOption = None,
    as_json: JsonFlag = False,
    seed: SeedOption = 0,
    threads: ThreadsOption = None,
) -> None:
    """Replay a recorded or synthetic intervention from raw streams to force, in time order.

    Calibrates tool, probe and latency, detects heart beats, registers ultrasound to the model and evaluates
    the fixtures at the tool tip every millisecond. Where the folder holds the truth, every error is printed.
    The pose goes to ITK, 3D Slicer and PLUS files, the ticks to a table (see the guide, results of a replay).
    Exits 7 after writing its evidence when no registration could be used, or no force was given.
    """
    with command(threads):
        from dvf_ig.core import QualityGateError
        from dvf_ig.io import output_folder
        from dvf_ig.replay import result_of, run_replay, table

        options, of_file = fixture_options.chosen_fixtures(fixture, fixtures)
        files, _ = read_agreeing(session, model, "replay")  # doubts are in the result
        if files.fixtures is not None:
            fixture_options.refuse_options(fixture, fixtures)
            options = files.fixtures
        mode = fixture_options.chosen_retiming(retiming, files.retiming or of_file)
        recorded = files.scenario
        with output_folder(out, run_files()):
            built, origin = patient_model(recorded.preop, files.model or model)
            with progress("replay") as report:
                finished = run_replay(
                    recorded,
                    model=built,
                    fixtures=fixture_options.with_margin(options, margin),
                    retiming=mode,
                    seed=seed,
                    progress=report,
                    live=files.record,
                )
            result = result_of(finished)
            written = write_run(finished, result, out, session, model)
        heading = ("", "estimate", "error against the truth" if finished.scenario.truth is not None else "")
        emit(result, [heading, *table(result)], as_json=as_json)
        typer.echo(origin, err=True)
        for name, frame in written.items():
            wrote(out / name, frame)
        for warning in result["warnings"]:
            warn(f"{warning['key']}: {warning['sentence']}")
        if finished.poses and finished.history.updates[-1].pose is None:
            warn("at the end no pose was in use: mr_from_tracker is the last one before it was suspended")
        if not finished.poses:
            reason = (
                result["registrations"][-1]["reason"] if finished.attempts else "the recording is too short"
            )
            raise QualityGateError(f"no registration could be used, so no force was given: {reason}")
        if result["no_force"] is not None:
            raise QualityGateError(f"no force was given: {result['no_force']}")
