"""A live session's setup from what its configuration names, and the files that it leaves."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dvf_ig.cli.run_outputs import run_files, write_run
from dvf_ig.cli.session_argument import patient_model
from dvf_ig.cli.shell import warn, wrote

if TYPE_CHECKING:
    from dvf_ig.cardiac import RetimeMode
    from dvf_ig.core import Landmarks, Rigid
    from dvf_ig.guidance import FixtureSet
    from dvf_ig.intake.calibrations import Calibrations
    from dvf_ig.intake.findings import Finding
    from dvf_ig.intake.parts import SessionFiles
    from dvf_ig.live.record import SessionRecord
    from dvf_ig.session import SessionHistory, SessionSetup


@dataclass(frozen=True, slots=True, eq=False)
class LiveSetup:
    """Setup of a live session, with its files and their evidence.

    Attributes:
        landmarks: touched before; None if a start pose takes their place.
        calibrations: in use, with their evidence.
        start: coarse mr_from_tracker that registration starts from.
        findings: in what the files disagree, though they can be used.
        origin: a line that says where the model is from.
    """

    files: "SessionFiles"
    setup: "SessionSetup"
    landmarks: "tuple[Landmarks, Landmarks] | None"
    calibrations: "Calibrations"
    start: "Rigid"
    findings: "tuple[Finding, ...]"
    origin: str


def live_setup(
    files: "SessionFiles", model: Path | None, fixtures: "FixtureSet", retiming: "RetimeMode", seed: int
) -> LiveSetup:
    """The setup of a session whose files agree.

    Raises:
        DvfIgError: the first reason why they cannot be used, or not together.
    """
    from dvf_ig.intake.calibrations import calibrate
    from dvf_ig.intake.fit import require_live_fit
    from dvf_ig.intake.start import landmarks_start, require_start, start_pose, touched_points
    from dvf_ig.session import EcgSource, SessionSetup, build_heart

    begin, preop = files.start, files.heart
    require_start(begin)
    calibrations = calibrate(files.calibrations, seed)
    used = calibrations.in_use
    built, origin = patient_model(preop, files.model or model)
    findings = require_live_fit(
        files.with_calibrations(used.probe_from_image, used.lag_s, used.tip).with_model(built)
    )
    heart = build_heart(preop, built)
    start = start_pose(begin, heart, seed)
    by_landmarks = landmarks_start(begin)
    setup = SessionSetup(
        heart,
        used,
        EcgSource(files.required_live.ecg.rate_hz),
        start=None if by_landmarks else start,
        touched=touched_points(begin, heart.model),
        fan=files.fan,
        fixtures=fixtures,
        retiming=retiming,
        seed=seed,
    )
    landmarks = None
    if by_landmarks and begin.landmarks_mr is not None and begin.landmarks_tracker is not None:
        landmarks = (begin.landmarks_mr, begin.landmarks_tracker)
    return LiveSetup(files, setup, landmarks, calibrations, start, findings, origin)


@contextmanager
def recorded_session(out: Path, ready: "LiveSetup") -> "Iterator[SessionRecord]":
    """A record in the folder, with everything attached that a replay needs in addition to messages."""
    from dvf_ig.intake.fixtures import structure_files
    from dvf_ig.intake.session_log.document import DOCUMENT, attach_heart, document_of_live
    from dvf_ig.intake.session_log.live import LIVE, live_document
    from dvf_ig.io import output_folder
    from dvf_ig.io.model.model_file import model_bytes
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
        for name, model in structure_files(setup.fixtures).items():
            log.attach(name, "application/octet-stream", b"".join(model_bytes(model)))

    with output_folder(out, run_files()), session_record(out, attach, warn) as record:
        yield record


def write_logged_run(out: Path, ready: "LiveSetup", history: "SessionHistory") -> None:
    """Write what a replay leaves next to the finished log, and print the files' names.

    Raises:
        UnreadableFileError: the session never began.
        OutputError: not writable.
    """
    from dvf_ig.intake.session_log.read import read_session_log
    from dvf_ig.live.record import LOG
    from dvf_ig.replay import Replay, result_of
    from dvf_ig.replay.repetition import recorded_ticks

    recordings = read_session_log(out / LOG, images=False)
    live = recordings.record
    if live is None:
        return
    ticks = recorded_ticks(live)
    seconds = float(ticks.t_s[-1] - ticks.t_s[0])
    replay = Replay(
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
    result = result_of(replay)
    files = write_run(replay, result, out, out / LOG, None)
    wrote(out / LOG)
    for name, frame in files.items():
        wrote(out / name, frame)
    for warning in result["warnings"]:
        warn(f"{warning['key']}: {warning['sentence']}")
