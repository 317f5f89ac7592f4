"""Files of a live session: the log while it runs, and at its end those of a replay."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from dvf_ig.cli.shell import warn, wrote

if TYPE_CHECKING:
    from dvf_ig.live.record import SessionRecord
    from dvf_ig.session import SessionHistory

    from .setup import LiveSetup

RESULT, PAGE = "result.json", "report.html"


@contextmanager
def recorded_session(out: Path, ready: "LiveSetup") -> "Iterator[SessionRecord]":
    """A record in the folder, with everything attached that a replay needs in addition to messages."""
    from dvf_ig.intake.session_log.document import document_of_live
    from dvf_ig.intake.session_log.heart import attach_heart
    from dvf_ig.intake.session_log.live import LIVE, live_document
    from dvf_ig.intake.session_log.topics import DOCUMENT
    from dvf_ig.io import output_folder
    from dvf_ig.io.ros.log_file import LogWriter
    from dvf_ig.live.record import session_record
    from dvf_ig.replay.outputs import NAMES
    from dvf_ig.replay.view_file import VIEW

    setup, files = ready.setup, ready.files
    in_use = setup.calibrations

    def attach(log: LogWriter) -> None:
        preop = attach_heart(log, files.heart, setup.heart.model)
        document = document_of_live(files, in_use.probe_from_image, in_use.lag_s, in_use.tip, preop)
        log.attach(DOCUMENT, "application/json", document)
        options = live_document(setup.fixtures, setup.retiming, setup.seed)
        log.attach(LIVE, "application/json", options)

    with output_folder(out, (RESULT, PAGE, VIEW, *NAMES)), session_record(out, attach, warn) as record:
        yield record


def write_run(out: Path, ready: "LiveSetup", history: "SessionHistory") -> None:
    """Write what a replay leaves, from the finished log.

    Raises:
        UnreadableFileError: the session never began.
        OutputError: not writable.
    """
    from dvf_ig.intake.session_log.read import read_session_log
    from dvf_ig.io import files_together, provenance_fields, write_json, write_text
    from dvf_ig.live.record import LOG
    from dvf_ig.replay import Replay, result_of
    from dvf_ig.replay.outputs import NAMES, write_outputs
    from dvf_ig.replay.page.replay_page import report_html
    from dvf_ig.replay.repetition import recorded_ticks
    from dvf_ig.replay.view_file import VIEW, write_view_file

    recordings = read_session_log(out / LOG, images=False)
    live = recordings.record
    if live is None:
        return
    ticks = recorded_ticks(live)
    seconds = float(ticks.t_s[-1] - ticks.t_s[0])
    done = Replay(
        recordings.scenario,
        ready.setup,
        ready.calibrations,
        ready.start,
        history,
        ticks,
        (*live.findings, *ready.findings),
        seconds,
        seconds,
    )
    result = result_of(done)
    with files_together(out, (RESULT, PAGE, VIEW, *NAMES)) as new:
        write_text(new / PAGE, report_html(done, result))
        write_json(new / RESULT, {**result, **provenance_fields()})
        frames = write_outputs(done.poses, ticks, new, recordings.scenario.tracked_against)
        write_view_file(done, new, out, out / LOG, None)

    for name in (LOG, RESULT, PAGE, VIEW, *frames):
        wrote(out / name, frames.get(name))
    for warning in result["warnings"]:
        warn(f"{warning['key']}: {warning['sentence']}")
