"""`dvf-ig replay`: a recorded intervention from raw streams to force."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .fixture_options import (
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
from .patient_model import patient_model
from .shell import JsonFlag, SeedOption, ThreadsOption, command, emit, output_dir, progress, warn, wrote

if TYPE_CHECKING:
    from dvf_ig.intake.read import SessionRecordings


def replay(
    out: Annotated[
        Path,
        typer.Option(
            "-o",
            "--out",
            callback=output_dir,
            help="Folder for the result, its page, the pose and the ticks.",
        ),
    ],
    scenario: Annotated[
        Path | None,
        typer.Argument(help="Scenario folder (see `dvf-ig synth scenario`) or LOG.mcap; or give --config."),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", help="SESSION.yaml that names your recordings (see `dvf-ig config init`)."),
    ] = None,
    model: Annotated[
        Path | None, typer.Option("--model", help="This patient's model, if `dvf-ig model build` made one.")
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
    """Replay a recorded or synthetic intervention from raw streams to force, in time order.

    Calibrates tool, probe and latency, detects heart beats, registers ultrasound to the model and evaluates
    the fixtures at the tool tip every millisecond. Where the folder holds the truth, every error is printed.
    The pose goes to ITK, 3D Slicer and PLUS files, the ticks to a table (see the guide, results of a replay).
    Exits 7 after writing its evidence when no registration could be used, or no force was given.
    """
    with command(threads):
        from dvf_ig.core import QualityGateError
        from dvf_ig.io import files_together, output_folder, provenance_fields, write_json, write_text
        from dvf_ig.replay import result_of, run_replay, table
        from dvf_ig.replay.outputs import NAMES, write_outputs
        from dvf_ig.replay.page.replay_page import report_html
        from dvf_ig.replay.view_file import VIEW, write_view_file

        given = {"law": law, "gamma": gamma, "delta": delta, "m": m, "cap_n": cap_n, "depth_mm": depth_mm}
        given |= {"inside": inside, "blend": blend}
        options, of_file = chosen_fixtures(given, fixtures)
        recordings = _read(scenario, config, model)
        if recordings.fixtures is not None:
            refuse_options(given, fixtures)
            options = recordings.fixtures
        mode = chosen_retiming(retiming, recordings.retiming or of_file)
        recorded = recordings.scenario
        names = ("result.json", "report.html", VIEW, *NAMES)
        with output_folder(out, names):
            built, origin = patient_model(recorded.preop, recordings.model or model)
            with progress("replay") as report:
                done = run_replay(
                    recorded,
                    model=built,
                    fixtures=with_margin(options, margin),
                    retiming=mode,
                    seed=seed,
                    progress=report,
                    live=recordings.live,
                )
            result = result_of(done)
            with files_together(out, names) as new:
                write_text(new / "report.html", report_html(done, result))
                write_json(new / "result.json", {**result, **provenance_fields()})
                frames = write_outputs(done.poses, done.ticks, new, recorded.tracked_against)
                write_view_file(done, new, out, config or scenario or Path(), model)
        heading = ("", "estimate", "error against the truth" if done.scenario.truth is not None else "")
        emit(result, [heading, *table(result)], as_json=as_json)
        typer.echo(origin, err=True)
        for name in ("result.json", "report.html", VIEW, *frames):
            wrote(out / name, frames.get(name))
        for warning in result["warnings"]:
            warn(f"{warning['key']}: {warning['sentence']}")
        if done.poses and done.history.updates[-1].pose is None:
            warn("at the end no pose was in use: mr_from_tracker is the last one before it was suspended")
        if not done.poses:
            reason = result["registrations"][-1]["reason"] if done.attempts else "the recording is too short"
            raise QualityGateError(f"no registration could be used, so no force was given: {reason}")
        if result["no_force"] is not None:
            raise QualityGateError(f"no force was given: {result['no_force']}")


def _read(scenario: Path | None, config: Path | None, model: Path | None) -> "SessionRecordings":
    """The recordings of a scenario folder or of a SESSION.yaml, which agree."""
    from dvf_ig.intake.fit import require_fit
    from dvf_ig.intake.read import SessionRecordings, read_session
    from dvf_ig.intake.scenario.read import read_scenario

    if scenario is not None and config is not None:
        raise typer.BadParameter("give a scenario folder or --config SESSION.yaml, not both")
    if scenario is None and config is None:
        raise typer.BadParameter("what is to be replayed? give a scenario folder, or --config SESSION.yaml")
    if scenario is not None and scenario.suffix == ".mcap":
        from dvf_ig.replay.export.session_log_read import read_session_log

        return read_session_log(scenario)
    if config is None:
        of_folder = SessionRecordings(read_scenario(scenario or Path()), None, None, None)
        require_fit(of_folder, "replay")
        return of_folder
    if model is not None:
        raise typer.BadParameter(f"{config} says whose model it is (preop.model); leave out --model")
    recordings = read_session(config)
    require_fit(recordings, "replay")
    return recordings
