"""The heart's pose from moment to moment: registrations now and then, and every beat in between.

    first      a registration from the start pose, repeated until the beats that follow agree with one
    in use     each beat is compared with the pose and updates it; a registration now and then besides
    suspended  no force; a registration from frames after the disturbance, and the beats that confirm it

Everything happens in time order. A registration takes effect COMPUTE_S after it was started; beats that end
meanwhile are compared with the pose in use, and with its result once that is there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from dvf_ig.cardiac import RPeak
from dvf_ig.core import FloatArray, Rigid, Stop
from dvf_ig.registration import PoseEstimate, RegistrationResult

from .beat_evaluation import BeatEvaluation
from .gated_frames import GatedFrames
from .pose_history import Attempt, PoseHistory
from .refusal import Refusal, Refused
from .registration_monitor import RegistrationMonitor

FIRST_ATTEMPT_S = 8.0
RETRY_S = 4.0
REFRESH_S = 12.0
RECOVER_S = 3.0
"""A suspended pose is registered anew when frames of this long after the disturbance are at hand."""
MEMORY_S = 12.0
"""How far back a registration looks: one refresh, so that a patient who moved is seen unmixed by the next."""
COMPUTE_S = 3.0
"""A registration takes effect this long after its last frame: a fixed allowance for computing it."""
REMEMBERED_BEATS = 6


class ComparableBeat(Protocol):
    """The ultrasound of one beat, see `beat_evaluation.BeatSlices`."""

    @property
    def begin_s(self) -> float: ...

    @property
    def end_s(self) -> float: ...

    def evaluate_beat(self, pose: Rigid, center_mm: FloatArray, *, in_use: bool) -> BeatEvaluation | None:
        """Compare the beat with a pose; None where they hardly overlap."""
        ...


class UltrasoundSource(Protocol):
    """The ultrasound that has arrived, as a tracker of the pose asks for it."""

    def register(
        self, from_s: float, until_s: float, start: Rigid, *, warm: bool, landmarks: bool
    ) -> tuple[GatedFrames, RegistrationResult | None]:
        """Register the frames in [from_s, until_s) from `start`; no result where they are too few.

        Args:
            warm: rely on the start; landmarks: touched landmarks, if any, take part.
        """
        ...

    def beat(self, last: int) -> ComparableBeat | None:
        """The beat that R peak number `last` ended; None where it cannot be compared with the model."""
        ...


@dataclass(frozen=True, slots=True)
class Timing:
    """Begin and end of a replay, and the delay of a beat's evaluation.

    Attributes:
        begin_s: event time of the first ultrasound frame; `end_s` of the last force.
        beat_compute_s: a beat's evaluation takes effect this long after its R peak was detected.
    """

    begin_s: float
    end_s: float
    beat_compute_s: float


def track_pose(
    source: UltrasoundSource,
    peaks: Sequence[RPeak],
    monitor: RegistrationMonitor,
    start: Rigid,
    timing: Timing,
    report_progress: Callable[[float], None],
) -> PoseHistory:
    """Track the heart's pose from the first ultrasound frame to the end of the recording.

    Args:
        peaks: R peaks in time order.
        start: coarse pose that the first registrations begin at.
    """
    tracker = PoseTracker(source, peaks, monitor, start, timing)
    for last in range(1, len(peaks)):
        now_s = peaks[last].detected_at_s + timing.beat_compute_s
        if now_s > timing.end_s:
            break
        tracker.register_until(now_s)
        tracker.evaluate_beat(last, now_s)
        done = (now_s - timing.begin_s) / (timing.end_s - timing.begin_s)
        report_progress(min(1.0, max(0.0, done)))
    tracker.register_until(timing.end_s)
    return tracker.history


class PoseTracker:
    """The state that moves through a recording; see the module docstring."""

    def __init__(
        self,
        source: UltrasoundSource,
        peaks: Sequence[RPeak],
        monitor: RegistrationMonitor,
        start: Rigid,
        timing: Timing,
    ) -> None:
        self._source, self._peaks, self._monitor, self._start = source, peaks, monitor, start
        self._end_s = timing.end_s
        self._frames_from_s = timing.begin_s
        """Earlier frames show another pose."""
        self._next_start_s, self._next_result_s = timing.begin_s + FIRST_ATTEMPT_S, np.inf
        self._recent: list[ComparableBeat] = []
        self._beat_pose: Rigid | None = None
        """The best pose of the last beat, from when one suspended the pose in use until a registration."""
        self._pending_attempt = -1
        self._attempts: list[Attempt] = []
        self._beats: list[BeatEvaluation] = []
        self._updates: list[tuple[float, Rigid | None]] = []

    @property
    def history(self) -> PoseHistory:
        return PoseHistory(tuple(self._attempts), tuple(self._beats), tuple(self._updates))

    def register_until(self, now_s: float) -> None:
        """Registrations that are to be started, or whose results take effect, by now."""
        while min(self._next_start_s, self._next_result_s) <= now_s:
            if self._next_result_s <= self._next_start_s:
                self._take_result(self._next_result_s)
            else:
                self._start_registration(self._next_start_s)

    def evaluate_beat(self, last: int, now_s: float) -> None:
        """Compare the beat that R peak number `last` ended with the pose under test."""
        beat = self._source.beat(last)
        if beat is None:
            return
        self._recent = [*self._recent[1 - REMEMBERED_BEATS :], beat]
        self._compare(beat, now_s)

    def _start_registration(self, now_s: float) -> None:
        self._next_start_s = np.inf
        if now_s + COMPUTE_S >= self._end_s:
            return
        start, warm = self._registration_start()
        since_s = max(self._frames_from_s, now_s - MEMORY_S)
        frames, result = self._source.register(
            since_s, now_s, start, warm=warm, landmarks=not self._monitor.doubted
        )
        self._attempts.append(Attempt(now_s, now_s + COMPUTE_S, frames, result))
        self._next_result_s = now_s + COMPUTE_S

    def _registration_start(self) -> tuple[Rigid, bool]:
        """Where a registration begins, and whether that is relied on.

        Right after a suspension it is the last beat's best pose; once such a start has failed, displaced
        copies of the last pose are tried besides.
        """
        tested = self._monitor.under_test
        if tested is None:
            return self._start, False
        if self._monitor.in_use:
            return tested.pose, True
        if self._beat_pose is not None:
            start, self._beat_pose = self._beat_pose, None
            return start, True
        return tested.pose, False

    def _take_result(self, now_s: float) -> None:
        self._next_result_s, attempt = np.inf, self._attempts[-1]
        self._next_start_s = attempt.asked_s + RETRY_S
        if attempt.result is None:
            return
        if not attempt.result.stop.usable:
            self._take_refusal(attempt.result.stop, now_s)
            return
        result, frames = attempt.result, attempt.frames
        middle_s = float(frames.event_s[frames.used].mean())
        beats = sum(middle_s < p.t_s < now_s for p in self._peaks)
        found = PoseEstimate.from_registration(result.target_from_source, result.covariance, result.center_mm)
        before = self._monitor
        self._monitor, refused = before.after_registration(found, beats)
        self._set_refused(-1, refused)
        self._record_update(before, now_s)
        if self._monitor.pending is found:
            self._pending_attempt = len(self._attempts) - 1
            self._next_start_s = now_s + REFRESH_S
            for beat in [b for b in self._recent if b.begin_s >= attempt.asked_s]:
                if self._monitor.in_use or self._monitor.pending is found:
                    self._compare(beat, now_s)
        elif self._monitor.in_use:
            self._next_start_s = attempt.asked_s + self._refresh_s(attempt.asked_s)

    def _take_refusal(self, stop: Stop, now_s: float) -> None:
        """A registration refused by its own evidence speaks against the pose in use."""
        before = self._monitor
        self._monitor = before.after_refusal(stop)
        self._record_update(before, now_s)
        if before.in_use and not self._monitor.in_use:
            asked_s = self._attempts[-1].asked_s
            self._frames_from_s = max(self._frames_from_s, asked_s)
            self._next_start_s = max(now_s, asked_s + RECOVER_S)

    def _compare(self, beat: ComparableBeat, now_s: float) -> None:
        """Compare a beat with the pose under test, and draw the consequences."""
        before = self._monitor
        tested = before.under_test
        if tested is None:
            return
        evaluation = beat.evaluate_beat(tested.pose, before.center_mm, in_use=before.in_use is not None)
        if evaluation is None:
            return
        self._beats.append(evaluation)
        self._monitor = before.after_beat(evaluation.measurement)
        self._record_update(before, now_s)
        if before.in_use and not self._monitor.in_use:
            self._suspend(beat.end_s, evaluation.measurement.best, now_s)
        elif before.pending is None and self._beat_pose is not None:
            self._beat_pose = evaluation.measurement.best
        elif before.pending and self._monitor.in_use:
            self._confirm(now_s)
        elif before.pending and self._monitor.pending is None:
            self._drop_pending(evaluation.measurement.moved_mm, now_s)

    def _suspend(self, end_s: float, beat_pose: Rigid, now_s: float) -> None:
        """Register anew from frames after the beat that contradicted the pose in use."""
        if np.isfinite(self._next_result_s):
            self._set_refused(-1, Refused(Refusal.SUSPENDED_MEANWHILE))
        self._frames_from_s, self._beat_pose = end_s, beat_pose
        self._next_start_s, self._next_result_s = max(now_s, end_s + RECOVER_S), np.inf

    def _confirm(self, now_s: float) -> None:
        self._set_refused(self._pending_attempt, None)
        asked_s = self._attempts[self._pending_attempt].asked_s
        self._next_start_s = max(now_s, asked_s + self._refresh_s(asked_s))

    def _drop_pending(self, off_mm: float, now_s: float) -> None:
        self._set_refused(self._pending_attempt, Refused(Refusal.BEAT_DISAGREES, off_mm))
        self._next_start_s = max(now_s, self._attempts[self._pending_attempt].asked_s + RETRY_S)

    def _set_refused(self, attempt: int, refused: Refused | None) -> None:
        self._attempts[attempt] = replace(self._attempts[attempt], refused=refused)

    def _refresh_s(self, asked_s: float) -> float:
        """A registration from little is repeated when there is twice as much."""
        return min(REFRESH_S, max(RETRY_S, asked_s - max(self._frames_from_s, asked_s - MEMORY_S)))

    def _record_update(self, before: RegistrationMonitor, now_s: float) -> None:
        was, now = before.in_use, self._monitor.in_use
        if now is not was:
            self._updates.append((now_s, now.pose if now else None))
