"""Read a session's log as a recording: the events that its replay pushes are those that were logged."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, PoseStream, Respiration, Scenario, Signal, TrackedSequence, TriggerTimes
from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.intake.fixtures import STRUCTURES
from dvf_ig.intake.parts import SessionFiles
from dvf_ig.intake.preop import PreopFiles, read_preop
from dvf_ig.io import limits, read_model
from dvf_ig.io.ecg.recording import require_plausible
from dvf_ig.io.file_within import path_within
from dvf_ig.io.provenance import not_recorded
from dvf_ig.io.ros import messages as ros
from dvf_ig.io.ros.log_file import LogReader, opened_log
from dvf_ig.io.writing.place import scratch_folder
from dvf_ig.io.yaml_config import validated

from .document import (
    DOCUMENT,
    ECG,
    EXACT_FRAME,
    EXACT_TOOL,
    IMAGE,
    MODEL,
    RESPIRATION,
    STREAMS,
    TRIGGER,
    SessionDocument,
    read_document,
)
from .live import LIVE, LiveDocument
from .live_read import read_live_streams

_POSE = 14
"""Count of numbers of a pose: stamp, validity, rotation, translation."""


def read_session_log(path: Path, *, images: bool = True) -> SessionFiles:
    """Read a log that `dvf-ig export mcap` or `dvf-ig serve` wrote.

    Args:
        images: whether to read the ultrasound of a live session.
    Returns:
        recording, calibrations in use, and the heart; for a live session also the data that repeat it.
    Raises:
        MissingDependencyError: mcap or rosbags is absent.
        UnreadableFileError: absent, another kind of file, cut off or damaged.
    """
    with opened_log(path) as log:
        attached = log.attachments()
        if DOCUMENT not in attached:
            raise UnreadableFileError(
                f"{path} has no {DOCUMENT} attached; needed a log that `dvf-ig export mcap` or "
                "`dvf-ig serve` wrote"
            )
        document = read_document(attached[DOCUMENT], path)
        heart = _heart(path, document, attached)
        if LIVE in attached:
            return _live(log, path, document, heart, attached, images=images)
        arrays: dict[str, list[FloatArray]] = {topic: [] for topic in STREAMS}
        shown: list[NDArray[np.uint8]] = []
        for topic, message in log.messages(STREAMS):
            if topic == IMAGE:
                shown.append(ros.grey_levels(message))
            else:
                arrays[topic].append(np.array(message.data, dtype=np.float64))
        scenario = _recorded(document, heart, arrays, shown)
        if isinstance(scenario.ecg, Signal):
            require_plausible(path, scenario.ecg)
    return SessionFiles.of(scenario, heart.model)


def _live(
    log: LogReader,
    path: Path,
    document: SessionDocument,
    heart: PreopFiles,
    attached: dict[str, bytes],
    *,
    images: bool,
) -> SessionFiles:
    try:
        content = json.loads(attached[LIVE])
    except (ValueError, RecursionError) as exc:
        raise UnreadableFileError(f"{path}: its {LIVE} is damaged ({exc})") from exc
    options = validated(LiveDocument, content, path)
    streams = read_live_streams(log, document, options, path, images=images)
    scenario = _scenario(document, heart, streams.ecg, streams.ultrasound, streams.tool)
    scenario = replace(scenario, respiration=streams.respiration)
    with scratch_folder() as folder, not_recorded():
        for file, data in attached.items():
            if file.startswith(STRUCTURES):
                path_within(folder, file, path).write_bytes(data)
        fixtures = options.fixtures.fixture_set(folder)
    return SessionFiles.of(
        scenario, heart.model, fixtures=fixtures, retiming=options.retiming, record=streams.record
    )


def _recorded(
    document: SessionDocument,
    heart: PreopFiles,
    arrays: dict[str, list[FloatArray]],
    images: list[NDArray[np.uint8]],
) -> Scenario:
    frames = np.array(arrays[EXACT_FRAME]).reshape(-1, _POSE + 1)
    probe = _stream("probe", frames[:, :_POSE])
    sequence = TrackedSequence(
        frames[:, 0],
        np.stack(images) if images else None,
        frames[:, _POSE] == 1.0,
        {probe.name: probe},
        document.has_timestamps,
        document.orientation,
    )
    tool = _stream("tool", np.array(arrays[EXACT_TOOL]).reshape(-1, _POSE))
    scenario = _scenario(document, heart, _beats(document, arrays), sequence, tool)
    return replace(scenario, respiration=_breaths(document, arrays[RESPIRATION]))


def _breaths(document: SessionDocument, rows: list[FloatArray]) -> Respiration | None:
    """Build the recording of breathing that the document names."""
    if document.respiration is None:
        return None
    if len({len(row) for row in rows}) != 1:
        raise InvalidInputError("the log's samples of breathing differ in length, or there are none")
    table = np.array(rows)
    limits.require_times(table[:, :1], "breathing")
    return Respiration(table[:, 0], table[:, 1:], document.respiration)


def _scenario(
    document: SessionDocument,
    heart: PreopFiles,
    ecg: Signal | TriggerTimes,
    ultrasound: TrackedSequence,
    tool: PoseStream,
) -> Scenario:
    touched, start = document.touched, document.start
    marked, at = document.landmarks_mr, document.landmarks_tracker
    return Scenario(
        name=document.name,
        preset=document.preset,
        preop=heart.preop,
        ecg=ecg,
        ultrasound=ultrasound,
        fan=None if document.fan is None else document.fan.fan(),
        probe=document.probe_from_image.image(),
        latency=document.lag_s,
        tool=tool,
        tracked_against=document.tracked_against,
        tip=document.tip.points(),
        start=None if start is None else start.rigid(),
        landmarks_mr=None if marked is None else marked.landmarks(),
        landmarks_tracker=None if at is None else at.landmarks(),
        touched=None if touched is None else touched.points(),
        touched_phase=document.touched_phase,
    )


def _beats(document: SessionDocument, arrays: dict[str, list[FloatArray]]) -> Signal | TriggerTimes:
    beats = document.beats
    if beats.kind == "trigger":
        return TriggerTimes(np.concatenate([np.zeros(0), *arrays[TRIGGER]]), beats.delay_s)
    flat = np.concatenate([np.zeros(0), *arrays[ECG]])
    samples = flat.reshape(-1, max(len(beats.leads), 1))
    return Signal(samples, beats.rate_hz or 0.0, beats.start_s or 0.0, beats.leads, beats.unit)


def _stream(source: str, rows: FloatArray) -> PoseStream:
    """Build tracker_from_source from rows of a stamp, a validity, a rotation and a translation."""
    rotations, translations, valid = rows[:, 2:11].reshape(-1, 3, 3), rows[:, 11:], rows[:, 1] == 1.0
    limits.require_times(rows[:, 0], f"the {source}'s poses")
    limits.require_lengths(translations[valid], f"the {source}'s poses")
    return PoseStream("tracker", source, rows[:, 0], rotations, translations, valid)


def _heart(path: Path, document: SessionDocument, attached: dict[str, bytes]) -> PreopFiles:
    """Read the heart from the attached files."""
    with scratch_folder() as folder, not_recorded():
        for file, data in attached.items():
            if file.startswith("preop/"):
                place = path_within(folder, file, path)
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_bytes(data)
        try:
            read = read_preop(document.preop, folder, document.patient_id)
            if read.model is None and MODEL in attached:
                return PreopFiles(read.preop, read_model(folder / MODEL, patient_id=document.patient_id))
            return read
        except InvalidInputError as exc:
            reason = str(exc).replace(f"{folder}/", "its ")
            raise UnreadableFileError(f"{path}: {reason}") from exc
