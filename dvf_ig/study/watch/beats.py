"""Beats of a session over a quiet recording, compared with its pose again with the heart displaced."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np

from dvf_ig.core import (
    HEART_RADIUS_MM,
    DvfModel,
    FloatArray,
    PoseMotion,
    Rigid,
    Scenario,
    ScenarioTruth,
    Warp,
    mean_displacement_mm,
    read_only_arrays,
)
from dvf_ig.guidance import Hazard
from dvf_ig.intake.calibrations import calibrate
from dvf_ig.intake.model_cache import cached_model
from dvf_ig.intake.start import landmarks_start, start_pose
from dvf_ig.registration import PoseEstimate, ShapeEstimate, ShiftDetector
from dvf_ig.replay import events_of
from dvf_ig.replay.result.pose import guarded_wall_rms_mm
from dvf_ig.session import BeatEvaluation, Session, SessionHistory, SessionSetup, beat_source_of, build_heart
from dvf_ig.session.beat_evaluation import ComparableBeat, ComparedBeat, evaluation_of
from dvf_ig.session.pose_states import Confirmation, InUse, Pose
from dvf_ig.session.pose_transition import BeatCompared, next_pose
from dvf_ig.session.work import InlineExecutor, Job
from dvf_ig.study.driver import Line

T = TypeVar("T")
STATE_EVERY_S = 0.1
"""The session is asked so often for its state, instead of every millisecond: it does the same work."""


@dataclass(frozen=True, slots=True, eq=False)
class WatchedBeat:
    """A beat that was compared with the pose in use.

    Attributes:
        slices: its ultrasound.
        evaluation: against that pose.
        estimate: that pose, before the beat.
        error_mm: of what its bound is on: the heart, or the guarded walls of one whose shape is followed.
    """

    slices: ComparableBeat
    evaluation: BeatEvaluation
    estimate: PoseEstimate
    error_mm: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class WatchedRecording:
    """Run of a session over a quiet recording.

    Attributes:
        beats: compared with the pose in use, in order.
        alarms: sentences of the doubts that suspended the pose.
        guided_s: time in which a pose was in use; unconfirmed_s: of it, with a pose that no beat confirmed.
    """

    beats: tuple[WatchedBeat, ...]
    alarms: tuple[str, ...]
    guided_s: float
    unconfirmed_s: float


class _KeepingExecutor(InlineExecutor):
    """Does the work when its result is due, and keeps the beats."""

    def __init__(self) -> None:
        self.slices: list[ComparableBeat] = []

    def submit(self, work: Callable[[], T]) -> Job[T]:
        def kept() -> T:
            completed = work()
            if isinstance(completed, ComparedBeat) and completed.slices is not None:
                self.slices.append(completed.slices)
            return completed

        return super().submit(kept)


def watch_recording(scenario: Scenario, seed: int) -> WatchedRecording:
    """Run a session over a synthetic recording in which nothing happens."""
    if scenario.truth is None:
        raise TypeError("a synthetic scenario has its truth")
    heart = build_heart(scenario.preop, cached_model(scenario.preop).model)
    start = None if landmarks_start(scenario) else start_pose(scenario, heart, seed)
    setup = SessionSetup(
        heart,
        calibrate(scenario, seed).in_use,
        beat_source_of(scenario.ecg),
        start=start,
        fan=scenario.fan,
        seed=seed,
    )
    history, executor = SessionHistory(), _KeepingExecutor()
    estimates: list[PoseEstimate] = []
    guided = unconfirmed = 0
    events = events_of(scenario)
    upcoming = next(events)
    last_s = float(scenario.ultrasound.t_s[-1])
    with Session(setup, executor=executor, history=history) as session:
        for now_s in np.arange(0.0, last_s, STATE_EVERY_S).tolist():
            while upcoming[0] <= now_s:
                session.push(upcoming[1])
                upcoming = next(events, (np.inf, upcoming[1]))
            state = session.state(now_s)
            if state.estimate is not None and (not estimates or estimates[-1] is not state.estimate):
                estimates.append(state.estimate)
            guided += state.transform.pose is not None
            unconfirmed += bool(state.supervised.hazards & Hazard.POSE_UNCONFIRMED)
    return WatchedRecording(
        _in_use(history, executor.slices, estimates, partial(_error_mm, heart.model, scenario.truth)),
        tuple(update.doubt.sentence for update in history.updates if update.doubt is not None),
        guided * STATE_EVERY_S,
        unconfirmed * STATE_EVERY_S,
    )


def _error_mm(model: DvfModel, truth: ScenarioTruth, estimate: PoseEstimate) -> float:
    true_pose = truth.mr_from_tracker_at(0.0)
    if estimate.warp is None:
        return mean_displacement_mm(estimate.pose, true_pose, estimate.center_mm)
    moved_mr = estimate.pose @ true_pose.inverse()
    return guarded_wall_rms_mm(model, truth.surface, moved_mr, estimate.warp)


def _in_use(
    history: SessionHistory,
    slices: list[ComparableBeat],
    estimates: list[PoseEstimate],
    error_mm: Callable[[PoseEstimate], float],
) -> tuple[WatchedBeat, ...]:
    """Beats with the estimate they were compared with: both hold the same pose."""
    of_begin = {beat.begin_s: beat for beat in slices}
    of_pose = {id(estimate.moved_by_beats): estimate for estimate in estimates}
    beats = []
    for evaluation in history.beats:
        estimate = of_pose.get(id(evaluation.measurement.pose))
        if evaluation.in_use and estimate is not None and evaluation.begin_s in of_begin:
            beat = of_begin[evaluation.begin_s]
            beats.append(WatchedBeat(beat, evaluation, estimate, error_mm(estimate)))
    return tuple(beats)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class DisplacedBeat:
    """A beat of a heart that lies `shift_mm` (3,), frame "mr", from where the recording has it.

    The pose that puts images of the displaced heart where they belong is E T, with T the recording's and E a
    translation by `shift_mm`: at X they match as the recorded images do at E⁻¹X.
    """

    beat: ComparableBeat
    shift_mm: FloatArray

    @property
    def begin_s(self) -> float:
        return self.beat.begin_s

    @property
    def end_s(self) -> float:
        return self.beat.end_s

    @property
    def view_mm(self) -> FloatArray:
        return self.beat.view_mm

    def correct(self, shape: ShapeEstimate, pose: Rigid) -> tuple[ShapeEstimate | None, float]:
        """See `ComparableBeat`."""
        return self.beat.correct(shape, moved(pose, -self.shift_mm))

    def evaluate_beat(self, pose: Rigid, center_mm: FloatArray, *, in_use: bool) -> BeatEvaluation | None:
        """See `ComparableBeat`."""
        back = moved(pose, -self.shift_mm)
        result = self.beat.evaluate_beat(back, center_mm - self.shift_mm, in_use=in_use)
        if result is None:
            return None
        best = moved(result.measurement.best, self.shift_mm)
        return replace(result, measurement=replace(result.measurement, pose=pose, best=best))


def moved(pose: Rigid, shift_mm: FloatArray) -> Rigid:
    """The pose of a heart that has moved by `shift_mm` (3,), target frame."""
    return pose.perturbed_left(np.zeros(3), shift_mm, np.zeros(3))


FIRST_ONSET, FOLLOWED_BEATS = 4, 10
"""The fifth beat is the first to be displaced; a shift is followed for ten beats at most."""


def detectors(beats: tuple[WatchedBeat, ...]) -> list[ShiftDetector]:
    """The detector before each beat, and after the last."""
    before = [ShiftDetector()]
    for beat in beats:
        measurement = beat.evaluation.measurement
        before.append(
            before[-1].after(beat.evaluation.begin_s, beat.estimate, measurement)
            if measurement.informative
            else before[-1]
        )
    return before


def statistics(beats: tuple[WatchedBeat, ...]) -> list[float]:
    """The statistic of `ShiftDetector` after each beat."""
    tests = [detector.test for detector in detectors(beats)[1:]]
    return [0.0 if test is None else test.statistic for test in tests]


def pose_before(recording: WatchedRecording, first: int) -> Pose:
    """Return the pose in use as it was before a beat."""
    beat = recording.beats[first]
    return InUse(
        beat.estimate,
        PoseMotion.still(beat.estimate.pose),
        None,
        Confirmation(beat.evaluation.begin_s, beat.estimate.pose_bound_mm),
        shift=detectors(recording.beats[:first])[-1],
    )


def beats_until_found(recording: WatchedRecording, first: int, shift_mm: FloatArray) -> int | None:
    """Beats from the shift at the beginning of beat `first` on, with the one that suspends the pose.

    None if FOLLOWED_BEATS do not. No registration takes part: it comes every 12 s, and would only find
    the shift sooner.
    """
    pose = pose_before(recording, first)
    for count, beat in enumerate(recording.beats[first : first + FOLLOWED_BEATS], start=1):
        pose = _after(pose, DisplacedBeat(beat.slices, shift_mm))
        if not isinstance(pose, InUse):
            return count
    return None


def followed_drift(recording: WatchedRecording, mm_per_s: FloatArray) -> Line | None:
    """A drift from the fifth beat to the last: how far the pose in use lags, and whether it is found.

    The lag is against the pose that the session had without a drift, displaced as the heart was. It counts
    while the pose is in use.
    """
    beats = recording.beats[FIRST_ONSET:]
    if not beats:
        return None
    pose, lag_mm, found_s = pose_before(recording, FIRST_ONSET), 0.0, None
    for beat in beats:
        since_s = beat.slices.end_s - beats[0].slices.begin_s
        gone_mm = mm_per_s * since_s
        pose = _after(pose, DisplacedBeat(beat.slices, gone_mm))
        if not isinstance(pose, InUse):
            found_s = since_s
            break
        lag_mm = max(lag_mm, _lag_mm(pose.estimate, beat.estimate, gone_mm))
    return {"lag_mm": round(lag_mm, 2), "found_s": found_s, "seconds": round(since_s, 1)}


def _lag_mm(estimate: PoseEstimate, recorded: PoseEstimate, gone_mm: FloatArray) -> float:
    """Mean distance between where two estimates put the heart, the second displaced by (3,) `gone_mm`."""
    there = np.vstack([np.eye(3), -np.eye(3)]) * HEART_RADIUS_MM + estimate.center_mm
    here = (estimate.pose @ recorded.pose.inverse()).apply_array(there - gone_mm)
    apart_mm = _in_model(estimate.warp, here) - _in_model(recorded.warp, there)
    return float(np.linalg.norm(apart_mm, axis=1).mean())


def _in_model(warp: Warp | None, places_mm: FloatArray) -> FloatArray:
    return places_mm if warp is None else warp.model_places(places_mm)


def _after(pose: Pose, beat: DisplacedBeat) -> Pose:
    if not isinstance(pose, InUse):
        return pose
    result = evaluation_of(beat, pose.estimate, in_use=True)
    return pose if result is None else next_pose(pose, BeatCompared(result.decided_s, result))[0]
