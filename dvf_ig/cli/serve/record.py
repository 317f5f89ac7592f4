"""Files of a live session: the log while it runs, and at its end those of a replay."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from dvf_ig.cli.run_outputs import run_files, write_logged_run
from dvf_ig.cli.shell import warn

if TYPE_CHECKING:
    from dvf_ig.live.record import SessionRecord
    from dvf_ig.session import SessionHistory

    from .setup import LiveSetup


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

    setup, files = ready.setup, ready.files
    in_use = setup.calibrations

    def attach(log: LogWriter) -> None:
        preop = attach_heart(log, files.heart, setup.heart.model)
        document = document_of_live(files, in_use.probe_from_image, in_use.lag_s, in_use.tip, preop)
        log.attach(DOCUMENT, "application/json", document)
        options = live_document(setup.fixtures, setup.retiming, setup.seed)
        log.attach(LIVE, "application/json", options)

    with output_folder(out, run_files()), session_record(out, attach, warn) as record:
        yield record


def write_run(out: Path, ready: "LiveSetup", history: "SessionHistory") -> None:
    """Write what a replay leaves, from the finished log.

    Raises:
        UnreadableFileError: the session never began.
        OutputError: not writable.
    """
    from dvf_ig.live.record import LOG

    write_logged_run(out / LOG, ready.setup, ready.calibrations, ready.start, history, ready.findings)
