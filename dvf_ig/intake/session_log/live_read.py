"""Read a live session's log: its events with their arrivals, in order, and the recording among them."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, PoseStream, Respiration, Signal, TrackedSequence, UnreadableFileError
from dvf_ig.intake.findings import Disagreement, Finding, finding
from dvf_ig.intake.live_record import Arrived, LiveRecord
from dvf_ig.io import limits
from dvf_ig.io.ros import messages as ros
from dvf_ig.io.ros.log_file import LogReader
from dvf_ig.session import EcgSamples, Landmark, Rearm, RespirationSample, ToolPose, TrackedFrame

from .document import ECG, EXACT_FRAME, EXACT_TOOL, IMAGE, RESPIRATION, STREAMS, TRIGGER, SessionDocument
from .live import EVENT, LIVE_STREAMS, LOST, STATE, WORK, EventKind, LiveDocument

Stamped = TypeVar("Stamped", TrackedFrame, ToolPose, RespirationSample)
UNIT = "as sent"
LONGEST_ECG_S = 24 * 3600.0
"""Largest distance from the first ECG sample, in stamps, of a sample that belongs to the recording."""


@dataclass(frozen=True, slots=True, eq=False)
class LiveStreams:
    """Streams sent to a live session, as a recording and in their order.

    Attributes:
        ecg: ECG on one clock; NaN if samples are missing.
        ultrasound: frames in order of their stamps; tool: its poses.
        respiration: what follows the breath; None if nothing does.
    """

    record: LiveRecord
    ecg: Signal
    ultrasound: TrackedSequence
    tool: PoseStream
    respiration: Respiration | None


@dataclass(slots=True)
class _Reading:
    """Log up to a message; an event's parts wait until the next event is announced."""

    landmarks: deque[Landmark]
    images: bool
    steps: list[Arrived | float] = field(default_factory=list)
    states: list[FloatArray] = field(default_factory=list)
    refused: dict[int, int] = field(default_factory=dict)
    announced: tuple[EventKind, float, float] | None = None
    numbers: FloatArray | None = None
    image: NDArray[np.uint8] | None = None

    def take(self, topic: str, message: ros.Message) -> None:
        if topic == IMAGE:
            self.image = ros.grey_levels(message)
            return
        values = np.array(message.data, dtype=np.float64)
        if topic in (ECG, EXACT_FRAME, EXACT_TOOL, RESPIRATION):
            leads = message.layout.dim[-1].size if topic == ECG else 1
            self.numbers = values.reshape(-1, leads) if topic == ECG else values
            return
        self.end_event()
        if topic == EVENT:
            self.announced = (EventKind(int(values[0])), float(values[1]), float(values[2]))
        elif topic == STATE:
            limits.require_times(values[0], "a state")
            self.steps.append(float(values[0]))
            self.states.append(values)
        elif topic == WORK:
            self.refused[int(values[0])] = int(values[1])

    def end_event(self) -> None:
        """Finish the announced event; one with missing parts is left out."""
        if self.announced is None:
            return
        kind, t_s, arrived_s = self.announced
        event = self._event(kind, t_s)
        if event is not None:
            self.steps.append((event, None if np.isnan(arrived_s) else arrived_s))
        self.announced = self.numbers = self.image = None

    def _event(
        self, kind: EventKind, t_s: float
    ) -> EcgSamples | RespirationSample | TrackedFrame | ToolPose | Landmark | Rearm | None:
        if kind is EventKind.REARM:
            return Rearm(t_s)
        if kind is EventKind.LANDMARK:
            marked = self.landmarks.popleft()
            return Landmark(t_s, marked.name, marked.mr_mm, marked.tracker_mm)
        if self.numbers is None:
            return None
        if kind is EventKind.ECG:
            return EcgSamples(t_s, self.numbers)
        if kind is EventKind.RESPIRATION:
            return RespirationSample(t_s, self.numbers[1:])
        pose = _matrix(self.numbers)
        if kind in (EventKind.TOOL, EventKind.DEVICE):
            return ToolPose(t_s, pose, kind is EventKind.DEVICE)
        cut_off = self.images and self.image is None and self.numbers[-1] == 1.0
        return None if cut_off else TrackedFrame(t_s, self.image, pose)


def read_live_streams(
    log: LogReader, document: SessionDocument, live: LiveDocument, path: Path, *, images: bool
) -> LiveStreams:
    """Read events, states and recordings of a live session's log.

    Args:
        images: whether to read images; without them a repetition registers nothing.
    Raises:
        UnreadableFileError: the session never began, as no tool was seen, or had no ultrasound.
    """
    reading = _Reading(_landmarks(document), images)
    topics = {**STREAMS, **LIVE_STREAMS}
    topics = {
        topic: kind for topic, kind in topics.items() if topic != TRIGGER and (images or topic != IMAGE)
    }
    for topic, message in log.messages(topics):
        reading.take(topic, message)
    reading.end_event()
    steps = tuple(reading.steps)
    if not reading.states:
        raise UnreadableFileError(
            f"{path} holds no state of its session, which begins with the tool's first pose"
        )
    states = np.stack(reading.states)
    record = LiveRecord(steps, reading.refused, states, live.seed, _findings(log, states))
    events = [step[0] for step in steps if isinstance(step, tuple)]
    frames = [event for event in events if isinstance(event, TrackedFrame)]
    tool = [event for event in events if isinstance(event, ToolPose)]
    if not frames or not tool:
        raise UnreadableFileError(f"{path} holds no {'pose of the tool' if frames else 'ultrasound'}")
    batches = [
        event for event in events if isinstance(event, EcgSamples) and abs(event.start_s) <= limits.TIME_S
    ]
    return LiveStreams(
        record,
        _signal(batches, document.beats.rate_hz or 0.0, float(states[0, 0])),
        _sequence(frames, document.orientation),
        _stream("tool", [(one.t_s, one.tracker_from_tool) for one in _in_order(tool)]),
        _breaths([event for event in events if isinstance(event, RespirationSample)], document),
    )


def _breaths(samples: Sequence[RespirationSample], document: SessionDocument) -> Respiration | None:
    ordered = _in_order(samples)
    if document.respiration is None or len(ordered) < 2:
        return None
    t_s, values = np.array([one.t_s for one in ordered]), np.array([one.values for one in ordered])
    return Respiration(t_s, values, document.respiration)


def _findings(log: LogReader, states: FloatArray) -> tuple[Finding, ...]:
    lost = max(int(states[-1, -1]), log.number(LOST) or 0)
    findings = []
    if not log.whole:
        findings.append(finding(Disagreement.RECORD_ENDS_EARLY, "record", "replay", s=float(states[-1, 0])))
    if lost:
        findings.append(finding(Disagreement.RECORD_LACKS_MESSAGES, "record", "replay", count=float(lost)))
    return tuple(findings)


def _landmarks(document: SessionDocument) -> deque[Landmark]:
    """In the order in which a session gets them."""
    if document.landmarks_mr is None or document.landmarks_tracker is None:
        return deque()
    names, marked, touched = document.landmarks_mr.landmarks().paired_with(
        document.landmarks_tracker.landmarks()
    )
    return deque(
        Landmark(0.0, name, mr_mm, tracker_mm)
        for name, mr_mm, tracker_mm in zip(names, marked.xyz_mm, touched.xyz_mm, strict=True)
    )


def _matrix(row: FloatArray) -> FloatArray | None:
    """(4, 4) of a row of stamp, validity, rotation and translation; None if it was not tracked."""
    if row[1] != 1.0:
        return None
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = row[2:11].reshape(3, 3), row[11:14]
    return matrix


def _in_order(events: Sequence[Stamped]) -> list[Stamped]:
    """Select events stamped later than all before, as a session does, at a valid time."""
    ordered: list[Stamped] = []
    for event in events:
        if not abs(event.t_s) <= limits.TIME_S:
            continue
        if not ordered or event.t_s > ordered[-1].t_s:
            ordered.append(event)
    return ordered


def _sequence(frames: Sequence[TrackedFrame], orientation: str) -> TrackedSequence:
    ordered = _in_order(frames)
    shown = [one.image for one in ordered if one.image is not None]
    blank = np.zeros(shown[0].shape if shown else (0, 0), dtype=np.uint8)
    fits = [one.image is not None and one.image.shape == blank.shape for one in ordered]
    images = [
        one.image if fit and one.image is not None else blank for one, fit in zip(ordered, fits, strict=True)
    ]
    probe = _stream("probe", [(one.t_s, one.tracker_from_probe) for one in ordered])
    return TrackedSequence(
        probe.t_s,
        np.stack(images) if shown else None,
        np.array(fits),
        {probe.name: probe},
        orientation=orientation,
    )


def _stream(source: str, poses: Sequence[tuple[float, FloatArray | None]]) -> PoseStream:
    """Build a pose stream; a pose not rigid or beyond any tracker's reach counts as not tracked."""
    t_s = np.array([one for one, _ in poses])
    near = [
        None if matrix is None or not (np.abs(matrix[:3, 3]) <= limits.LENGTH_MM).all() else matrix
        for _, matrix in poses
    ]
    return PoseStream.of_matrices("tracker", source, t_s, near)


def _signal(batches: Sequence[EcgSamples], rate_hz: float, begin_s: float) -> Signal:
    """Place batches on one clock; without any, unknown samples from `begin_s` on.

    Implausible values, which a session may have been sent, also become unknown.
    """
    if not batches:
        return Signal(np.full((2, 1), np.nan), rate_hz, begin_s, ("ECG",), UNIT)
    first_s, leads = batches[0].start_s, batches[0].samples.shape[1]
    placed = [
        (round((one.start_s - first_s) * rate_hz), one.samples)
        for one in batches
        if 0.0 <= one.start_s - first_s <= LONGEST_ECG_S and one.samples.shape[1] == leads
    ]
    length = max(2, *(at + len(samples) for at, samples in placed))
    limits.require_count(length * leads, limits.SAMPLES, "samples of an ECG")
    signal = np.full((length, leads), np.nan)
    for at, samples in placed:
        signal[at : at + len(samples)] = np.where(np.abs(samples) <= limits.ECG_VALUE, samples, np.nan)
    names = tuple(f"lead {n + 1}" for n in range(leads)) if leads > 1 else ("ECG",)
    return Signal(signal, rate_hz, first_s, names, UNIT)
