"""Files that a run leaves in its folder, after `replay` and after `serve`: result, page, view and poses."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvf_ig.cli.shell import warn, wrote

if TYPE_CHECKING:
    from dvf_ig.core import Rigid
    from dvf_ig.intake.calibrations import Calibrations
    from dvf_ig.intake.findings import Finding
    from dvf_ig.replay import Replay
    from dvf_ig.session import SessionHistory, SessionSetup

RESULT, PAGE = "result.json", "report.html"


def run_files() -> tuple[str, ...]:
    """Names of every file that may be written."""
    from dvf_ig.replay.outputs import NAMES
    from dvf_ig.replay.view_file import STRUCTURE_FILES, VIEW

    return (RESULT, PAGE, VIEW, *NAMES, *STRUCTURE_FILES)


def write_run(
    done: "Replay", result: dict[str, Any], out: Path, recording: Path, model: Path | None
) -> dict[str, str | None]:
    """Write all files of a run or none.

    Args:
        recording: scenario folder, SESSION.yaml or log.
        model: file of the model, if it was named for this run.
    Returns:
        the names of the files, and the frame of the content of each that has one.
    Raises:
        OutputError: not writable.
    """
    from dvf_ig.io import files_together, provenance_fields, write_json, write_text
    from dvf_ig.replay.outputs import write_outputs
    from dvf_ig.replay.page.replay_page import report_html
    from dvf_ig.replay.view_file import VIEW, write_view_file

    with files_together(out, run_files()) as new:
        write_text(new / PAGE, report_html(done, result))
        write_json(new / RESULT, {**result, **provenance_fields()})
        warps = [update.warp for update in done.history.updates if update.pose is not None]
        warp = warps[-1] if warps else None
        frames = write_outputs(done.poses, done.ticks, new, done.scenario.tracked_against, warp)
        write_view_file(done, new, out, recording, model)
    return {RESULT: None, PAGE: None, VIEW: None, **frames}


def write_logged_run(
    log: Path,
    setup: "SessionSetup",
    calibrations: "Calibrations",
    start: "Rigid",
    history: "SessionHistory",
    findings: "tuple[Finding, ...]",
) -> None:
    """Write the files of a live run next to its finished log, and print their names.

    Args:
        findings: in what the session's files disagreed, though they could be used.
    Raises:
        UnreadableFileError: the session never began.
        OutputError: not writable.
    """
    from dvf_ig.intake.session_log.read import read_session_log
    from dvf_ig.replay import Replay, result_of
    from dvf_ig.replay.repetition import recorded_ticks

    recordings, out = read_session_log(log, images=False), log.parent
    live = recordings.record
    if live is None:
        return
    ticks = recorded_ticks(live)
    seconds = float(ticks.t_s[-1] - ticks.t_s[0])
    done = Replay(
        recordings.scenario,
        setup,
        calibrations,
        start,
        history,
        ticks,
        (*live.findings, *findings),
        seconds,
        seconds,
    )
    result = result_of(done)
    files = write_run(done, result, out, log, None)
    wrote(log)
    for name, frame in files.items():
        wrote(out / name, frame)
    for warning in result["warnings"]:
        warn(f"{warning['key']}: {warning['sentence']}")
