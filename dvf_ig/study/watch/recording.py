"""A quiet recording through a session, with every beat kept so that it can be compared with other poses."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from dvf_ig.core import FloatArray, Rigid, Scenario, read_only_arrays
from dvf_ig.guidance import Hazard
from dvf_ig.intake import cached_model
from dvf_ig.registration import PoseEstimate
from dvf_ig.replay import events_of
from dvf_ig.replay.calibrations import calibrate
from dvf_ig.replay.start import landmarks_start, start_pose
from dvf_ig.session import (
    BeatEvaluation,
    InCaller,
    Job,
    Session,
    SessionHistory,
    SessionSetup,
    beat_source_of,
    build_heart,
)
from dvf_ig.session.ultrasound.beat_evaluation import ComparableBeat, ComparedBeat

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
    """

    slices: ComparableBeat
    evaluation: BeatEvaluation
    estimate: PoseEstimate


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class WatchedRecording:
    """What a session made of a quiet recording.

    Attributes:
        center_mm: (3,) centre of the heart box, frame "mr".
        truth: mr_from_tracker.
        beats: compared with the pose in use, in order.
        alarms: sentences of the doubts that suspended the pose.
        guided_s: time in which a pose was in use; unconfirmed_s: of it, with a pose that no beat confirmed.
    """

    center_mm: FloatArray
    truth: Rigid
    beats: tuple[WatchedBeat, ...]
    alarms: tuple[str, ...]
    guided_s: float
    unconfirmed_s: float


class _KeepingExecutor(InCaller):
    """Does the work when its result is due, and keeps the beats."""

    def __init__(self) -> None:
        self.slices: list[ComparableBeat] = []

    def submit(self, work: Callable[[], T]) -> Job[T]:
        def kept() -> T:
            done = work()
            if isinstance(done, ComparedBeat) and done.slices is not None:
                self.slices.append(done.slices)
            return done

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
    held: list[PoseEstimate] = []
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
            if state.estimate is not None and (not held or held[-1] is not state.estimate):
                held.append(state.estimate)
            guided += state.transform.pose is not None
            unconfirmed += bool(state.supervised.hazards & Hazard.POSE_UNCONFIRMED)
    return WatchedRecording(
        heart.center_mm,
        scenario.truth.mr_from_tracker_at(0.0),
        _in_use(history, executor.slices, held),
        tuple(update.doubt.sentence for update in history.updates if update.doubt is not None),
        guided * STATE_EVERY_S,
        unconfirmed * STATE_EVERY_S,
    )


def _in_use(
    history: SessionHistory, slices: list[ComparableBeat], held: list[PoseEstimate]
) -> tuple[WatchedBeat, ...]:
    """Beats with the estimate they were compared with: both hold the same pose."""
    of_begin = {beat.begin_s: beat for beat in slices}
    of_pose = {id(estimate.pose): estimate for estimate in held}
    beats = []
    for evaluation in history.beats:
        estimate = of_pose.get(id(evaluation.measurement.pose))
        if evaluation.in_use and estimate is not None and evaluation.begin_s in of_begin:
            beats.append(WatchedBeat(of_begin[evaluation.begin_s], evaluation, estimate))
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

    def evaluate_beat(self, pose: Rigid, center_mm: FloatArray, *, in_use: bool) -> BeatEvaluation | None:
        """See `ComparableBeat`."""
        back = moved(pose, -self.shift_mm)
        found = self.beat.evaluate_beat(back, center_mm - self.shift_mm, in_use=in_use)
        if found is None:
            return None
        best = moved(found.measurement.best, self.shift_mm)
        return replace(found, measurement=replace(found.measurement, pose=pose, best=best))


def moved(pose: Rigid, shift_mm: FloatArray) -> Rigid:
    """The pose of a heart that has moved by `shift_mm` (3,), target frame."""
    return pose.perturbed_left(np.zeros(3), shift_mm, np.zeros(3))
