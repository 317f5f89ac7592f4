"""Data that a running session sends to its page: the scene, and an event up to 30 times a second.

The session's thread only stores references here, without a lock; a thread of the page converts them and the
picture to JSON, and only while the page is watched. The scene is made before the session
runs: JSON of a whole heart holds the interpreter for longer than a session may wait.
"""

import json
from collections import deque
from dataclasses import asdict, replace
from typing import Any, TypeVar

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.guidance import SupervisorState
from dvf_ig.guidance.servo import SentForce
from dvf_ig.live.loop import Answer
from dvf_ig.live.sentences import REARM
from dvf_ig.report.viewer import (
    ImageShape,
    Mark,
    SceneInput,
    frame_event,
    image_shape,
    scene_payload,
    state_event,
)
from dvf_ig.report.viewer.frames import SENT_COLUMNS
from dvf_ig.report.viewer.scene import image_payload
from dvf_ig.session import EcgSamples, Event, GuidanceState, SessionHistory, SessionSetup, TrackedFrame
from dvf_ig.session.pose_states import MAX_AGE_S

T = TypeVar("T")
FRAMES_HZ = 10.0
ECG_HZ = 250.0
"""Rate to which the ECG is thinned."""
JUDGED_AFTER_S = 5.0
"""Time after which a registration that heart beats have not confirmed is reported as refused."""
LAST_AFTER_S = 1e-3
KEPT = 512
"""Largest number of ECG batches, or marks, that wait for the page."""


class PageFeed:
    """Data exchange between a session and its page.

    Args:
        setup: setup of the session.
        ecg_hz: rate of the ECG.
        history: history of the session.
    """

    def __init__(self, setup: SessionSetup, ecg_hz: float, history: SessionHistory) -> None:
        self._setup, self._history = setup, history
        self._ecg_hz, self._every = ecg_hz, max(1, round(ecg_hz / ECG_HZ))
        self._shape: ImageShape | None = None
        self._pixels: tuple[int, ...] = ()
        scene = scene_payload(
            SceneInput(
                kind="live",
                title=f"live: {setup.heart.model.patient_id}",
                model=setup.heart.model,
                fixtures=setup.fixtures,
                image=None,
                ecg=("ECG", ""),
                age_limit_s=MAX_AGE_S,
            )
        )
        rest = {key: value for key, value in scene.items() if key != "image"}
        self._scene = json.dumps(rest, allow_nan=False)[:-1].encode()
        """Scene as JSON, without its image and the closing brace."""
        self._answer: Answer | None = None
        self._ended = ""
        """Why the session has ended; empty while it runs."""
        self._ecg: deque[EcgSamples] = deque(maxlen=KEPT)
        self._frame: TrackedFrame | None = None
        self._frame_s = self._told_s = float("-inf")
        self._peaks: deque[float] = deque(maxlen=KEPT)
        self._marks: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._seen_peak_s = self._seen_registration_s = float("-inf")

    # ------------------------------------------------------------------ by the session's thread

    def observe(self, answer: Answer) -> None:
        """Store an answer that was sent."""
        self._note_history(answer.state.now_s)
        self._answer = answer

    def end(self, sentence: str) -> None:
        """Store the last answer again with no force, latched, and why; after the session has ended."""
        answer = self._answer
        if answer is None:
            return
        now_s = answer.state.now_s + LAST_AFTER_S
        hazards = answer.state.supervised.hazards if answer.sent is None else answer.sent.hazards
        last = SentForce(now_s, np.zeros(3), SupervisorState.LATCHED, hazards)
        self._ended = sentence
        self._answer = replace(answer, state=replace(answer.state, now_s=now_s), sent=last)

    def event(self, event: Event) -> None:
        """Store an event that was pushed."""
        if isinstance(event, EcgSamples):
            self._ecg.append(event)
        elif isinstance(event, TrackedFrame) and event.image is not None:
            self._frame = event

    def _note_history(self, now_s: float) -> None:
        """Store new peaks and registrations; both only grow at their ends."""
        peaks = self._history.peaks
        fresh = []
        for peak in reversed(peaks):
            if peak.t_s <= self._seen_peak_s:
                break
            fresh.append(peak.t_s)
        if fresh:
            self._seen_peak_s = fresh[0]
            self._peaks.extend(reversed(fresh))
        newest = self._history.last_registration
        if newest is not None and newest.asked_s > self._seen_registration_s:
            waited_s = now_s - newest.ready_s
            if newest.usable or waited_s > JUDGED_AFTER_S:
                self._seen_registration_s = newest.asked_s
                kind = "registration" if newest.usable else "refused"
                bound_mm = None if newest.result is None else newest.result.tre_bound_mm
                mark = Mark(newest.ready_s, kind, newest.reason, bound_mm=bound_mm)
                self._marks.append(asdict(mark))

    # ------------------------------------------------------------------ by the page's thread

    def scene(self) -> tuple[bytes, bytes]:
        """Return scene.json in two parts; the image's size is known with the first frame."""
        shape = self._shape_of(self._frame)
        image = json.dumps(None if shape is None else image_payload(shape), allow_nan=False)
        return self._scene, f', "image": {image}}}'.encode()

    def next_event(self) -> str | None:
        """Return what is new since the last call as JSON, or None."""
        answer = self._answer
        if answer is None or answer.state.now_s <= self._told_s:
            return None
        self._told_s = answer.state.now_s
        batches, peaks, marks = _taken(self._ecg), _taken(self._peaks), _taken(self._marks)
        state = answer.state
        event = state_event(state, self._setup.fixtures.tool, answer.sent)
        reasons = state.reasons if answer.sent is None else answer.sent.hazards.sentences
        event["reasons"] = [*reasons, *([REARM] if answer.supervisor is SupervisorState.LATCHED else [])]
        if self._ended:
            event["reasons"] = [self._ended]
        if batches:
            event["ecg"] = self._thinned(batches)
        if peaks:
            event["r_peaks_s"] = [round(t_s, 4) for t_s in peaks]
        if marks:
            event["marks"] = marks
        frame = self._frame
        if frame is not None and frame.t_s - self._frame_s >= 1.0 / FRAMES_HZ:
            self._frame_s = frame.t_s
            placed = self._placed(frame, state)
            if placed is not None:
                event["frame"] = placed
        return json.dumps(event, allow_nan=False)

    def _thinned(self, batches: list[EcgSamples]) -> dict[str, list[float | None]]:
        t_s = np.concatenate([b.start_s + np.arange(len(b.samples)) / self._ecg_hz for b in batches])
        values = np.concatenate([b.samples[:, 0] for b in batches])
        thinned = slice(None, None, self._every)
        return {
            "t_s": [round(t, 4) for t in t_s[thinned].tolist()],
            "values": [float(f"{v:.5g}") if np.isfinite(v) else None for v in values[thinned].tolist()],
        }

    def _shape_of(self, frame: TrackedFrame | None) -> ImageShape | None:
        image = None if frame is None else frame.image
        if image is not None and (self._shape is None or self._pixels != image.shape):
            self._pixels = rows, columns = image.shape
            pixel_mm = self._setup.calibrations.probe_from_image.scale_mm_per_px.tolist()
            self._shape = image_shape(rows, columns, pixel_mm, self._setup.fan, SENT_COLUMNS)
        return self._shape

    def _placed(self, frame: TrackedFrame, state: GuidanceState) -> dict[str, Any] | None:
        shape = self._shape_of(frame)
        if shape is None or frame.image is None:
            return None
        event_s = frame.t_s + self._setup.calibrations.lag_s
        phase = state.model_phase if np.isfinite(state.model_phase) else None
        return frame_event(frame.image, shape, event_s, phase, self._mr_from_pixel(frame, state))

    def _mr_from_pixel(self, frame: TrackedFrame, state: GuidanceState) -> FloatArray | None:
        """Compute (3, 3) from the pose in use and the probe's pose recorded with the frame."""
        pose = state.transform.pose
        if pose is None or frame.tracker_from_probe is None or state.now_s >= state.transform.pose_until_s:
            return None
        probe_from_pixel = self._setup.calibrations.probe_from_image.matrix[:, [0, 1, 3]]
        mr_from_tracker = pose.matrices(np.array([state.now_s]))[0]
        return np.asarray(mr_from_tracker @ frame.tracker_from_probe @ probe_from_pixel)


def _taken(waiting: deque[T]) -> list[T]:
    """Remove the entries that the session's thread has stored."""
    return [waiting.popleft() for _ in range(len(waiting))]
