"""A heart's pose from beat to beat, with ultrasound made from a known motion of the patient."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Generic, TypeVar

import numpy as np
import pytest
from known_patient import DETECTION_S, Patient, known_beat, registration, still

from dvf_ig.cardiac import RPeak
from dvf_ig.core import FloatArray, PoseMotion, Rigid, Stop, mean_displacement_mm
from dvf_ig.core.space.pose_motion import UPDATE_MM_PER_S
from dvf_ig.registration import Gated, PoseChart, PoseEstimate
from dvf_ig.replay.result.pose import drift_mm_per_min, suspensions
from dvf_ig.session import DoubtCause, Job, Landmark, PoseUpdate, Refusal, SessionHistory
from dvf_ig.session import RegistrationRecord as Record
from dvf_ig.session import RegistrationRequest as Request
from dvf_ig.session.beat_evaluation import BEAT_COMPUTE_S, ComparedBeat, evaluation_of
from dvf_ig.session.gated_frames import GatedFrames
from dvf_ig.session.pose_states import MAX_AGE_S, MAX_MISSED_BEATS
from dvf_ig.session.pose_tracker import PoseTracker
from dvf_ig.session.pose_transition import RECOVER_S, RETRY_S
from dvf_ig.session.registration_plan import FIRST_REGISTRATION_S
from dvf_ig.session.work import COMPUTE_S, GATHER_S, LATEST_S, POLL_S

T = TypeVar("T")
CENTER = np.array([10.0, -20.0, 30.0])
HOME = Rigid.from_rotation_vector([0.2, -0.1, 0.4], [5.0, 6.0, -7.0], "mr", "tracker")
RR_S = 0.8


def pose_at(patient: Patient, t_s: float) -> Rigid:
    return PoseChart(HOME, CENTER).pose(patient(t_s))


@dataclass
class Simulated(Generic[T]):
    """Work that is finished at a time of the events."""

    now_s: Callable[[], float]
    ready_s: float
    value: T
    polls: list[float] = field(default_factory=list)
    taken: bool = False

    def done(self) -> bool:
        self.polls.append(self.now_s())
        return self.now_s() >= self.ready_s

    def result(self) -> T:
        self.taken = True
        return self.value


@dataclass
class Ultrasound:
    """Ultrasound of a known patient, whose registrations take `seconds` each, fail or refuse themselves."""

    patient: Patient = still
    seconds: list[float] = field(default_factory=list)
    beat_seconds: float = 0.0
    refused_from_s: float = np.inf
    blind_from_s: float = np.inf
    failing: tuple[int, ...] = ()
    now_s: float = 0.0
    stepped_s: list[float] = field(default_factory=list)
    requests: list[Request] = field(default_factory=list)
    known_s: list[float] = field(default_factory=list)
    jobs: list[Simulated[Record]] = field(default_factory=list)

    def register(self, request: Request, known_s: float) -> Job[Record]:
        event_s = np.arange(request.from_s, request.until_s, 1 / 12)
        n, index = len(event_s), np.arange(len(event_s), dtype=np.int64)
        turns = np.tile(np.eye(3), (n, 1, 1))
        frames = GatedFrames(0, 0, Gated(index, {}), index, event_s, np.zeros(n), turns, np.zeros((n, 3)))
        mean = np.mean([self.patient(t) for t in event_s], axis=0)
        result = registration(PoseChart(HOME, CENTER).pose(mean), CENTER)
        if request.until_s > self.refused_from_s:
            result = replace(result, stop=Stop.POOR_MATCH)
        record = request.record(frames, result)
        if len(self.requests) in self.failing:
            record = request.record(frames, failure="the images are black")
        self.requests.append(request)
        self.known_s.append(known_s)
        ready_s = request.until_s + (self.seconds.pop(0) if self.seconds else 0.0)
        self.jobs.append(Simulated(lambda: self.now_s, ready_s, record))
        return self.jobs[-1]

    def beat(
        self, peaks: tuple[RPeak, ...], known_s: float, tested: PoseEstimate | None, *, in_use: bool
    ) -> Job[ComparedBeat]:
        begin_s, end_s = peaks[-2].t_s, peaks[-1].t_s
        compared = ComparedBeat(None, None, irregular=False)
        if begin_s < self.blind_from_s:
            beat = known_beat(begin_s, end_s, pose_at(self.patient, (begin_s + end_s) / 2))
            evaluation = None if tested is None else evaluation_of(beat, tested, in_use=in_use)
            compared = ComparedBeat(beat, evaluation, irregular=False)
        return Simulated(lambda: self.now_s, known_s + self.beat_seconds, compared)


def tracked(
    ultrasound: Ultrasound,
    until_s: float = 60.0,
    *,
    start: Rigid | None = HOME,
    landmarks: tuple[Landmark, ...] = (),
    observe: Callable[[PoseTracker], None] = lambda tracker: None,
) -> PoseTracker:
    """Everything that happens until the last beat is evaluated."""
    tracker = PoseTracker(ultrasound, start, SessionHistory())
    tracker.begin(0.0)
    peaks = [RPeak(RR_S * k, RR_S * k + DETECTION_S, 1.0) for k in range(round(until_s / RR_S))]
    inputs = [(p.detected_at_s, p) for p in peaks] + [(m.t_s, m) for m in landmarks]
    for at_s, event in [*sorted(inputs, key=lambda one: one[0]), (peaks[-1].detected_at_s + 0.5, None)]:
        while tracker.next_s < at_s:
            ultrasound.now_s = tracker.next_s
            ultrasound.stepped_s.append(tracker.next_s)
            tracker.step()
            observe(tracker)
        if isinstance(event, RPeak):
            tracker.add_peak(event)
        elif event is not None:
            tracker.add_landmark(event)
    return tracker


def shifted(t_s: float) -> FloatArray:
    return np.array([1.0, 0.0, -1.5, 5.0, -4.0, 4.0]) * min(1.0, max(0.0, (t_s - 30.0) / 0.5))


def drifting(t_s: float) -> FloatArray:
    return np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0]) * max(0.0, t_s - 15.0)


def slipped(t_s: float) -> FloatArray:
    """After a slip the pose that fits swings with the probe."""
    swing = 2 * np.pi * (t_s - 30.0) / 9.0
    return float(t_s >= 30.0) * np.array([0.0, 0.0, 0.0, 6.0 * np.cos(swing), 6.0 * np.sin(swing), 0.0])


def spans(history: SessionHistory) -> tuple[tuple[float, float], ...]:
    return suspensions(history.updates, 60.0)


# ------------------------------------------------------------------ patients


def test_a_still_patient_is_never_suspended() -> None:
    history = tracked(Ultrasound()).history
    assert history.updates[0].from_s <= FIRST_REGISTRATION_S + COMPUTE_S + 2 * RR_S
    assert all(update.pose is not None for update in history.updates)
    assert all(record.usable for record in history.registrations)
    assert drift_mm_per_min(history.updates, CENTER) == pytest.approx(0.0, abs=1e-9)


def test_a_patient_who_moved_is_noticed_within_a_beat_and_found_again() -> None:
    history = tracked(Ultrasound(shifted)).history
    ((begin_s, end_s),) = spans(history)
    assert 30.0 < begin_s <= 30.5 + 2 * RR_S + DETECTION_S + BEAT_COMPUTE_S
    assert end_s - begin_s <= RECOVER_S + COMPUTE_S + 2 * RR_S
    pose = next(update.pose for update in history.updates if update.from_s == end_s)
    assert pose is not None
    assert mean_displacement_mm(pose, pose_at(shifted, 60.0), CENTER) < 0.01  # exact beats
    again = next(record for record in history.registrations if record.asked_s > begin_s)
    assert again.frames is not None
    assert again.frames.event_s[0] >= begin_s - DETECTION_S - BEAT_COMPUTE_S - 1e-6
    assert again.usable


def test_a_slow_drift_is_tracked_and_reported() -> None:
    history = tracked(Ultrasound(drifting)).history
    assert not spans(history)
    late: list[PoseUpdate] = [update for update in history.updates if update.from_s > 25.0]
    for update in late:
        assert update.pose is not None
        assert mean_displacement_mm(update.pose, pose_at(drifting, update.from_s), CENTER) < 0.76  # 0.59
    drift = drift_mm_per_min(late, CENTER)
    assert drift is not None
    assert abs(drift - 6.0) < 0.12  # 0.09


def test_after_a_slip_no_pose_is_used_again() -> None:
    history = tracked(Ultrasound(slipped)).history
    begin_s, end_s = spans(history)[0]
    assert 30.0 < begin_s < 32.0
    assert end_s == 60.0
    after = [record for record in history.registrations if record.asked_s > begin_s]
    assert len(after) >= 3
    assert not any(record.usable for record in after)


def test_without_comparable_beats_no_pose_is_used() -> None:
    history = tracked(Ultrasound(blind_from_s=0.0)).history
    assert not history.updates
    assert history.registrations
    assert not any(record.usable for record in history.registrations)


def test_later_beats_change_nothing_before() -> None:
    whole, part = tracked(Ultrasound(shifted)).history, tracked(Ultrasound(shifted), 40.0).history
    until_s = 49 * RR_S + DETECTION_S
    assert len(part.updates) > 10
    early = [update for update in whole.updates if update.from_s <= until_s]
    for first, second in zip(early, part.updates, strict=False):
        assert first.from_s == second.from_s
        assert (first.pose is None) == (second.pose is None)
        if first.pose is not None and second.pose is not None:
            np.testing.assert_array_equal(first.pose.matrix, second.pose.matrix)


def test_a_pose_that_no_beat_confirms_ages_until_it_is_withheld() -> None:
    confirmed = tracked(Ultrasound(blind_from_s=30.0), 38 * RR_S).confirmation
    assert confirmed is not None
    assert confirmed.missed_beats == 0
    assert confirmed.until_s == confirmed.confirmed_s + MAX_AGE_S
    aged = tracked(Ultrasound(blind_from_s=30.0), 42 * RR_S)
    assert aged.in_use is not None
    assert aged.confirmation is not None
    assert aged.confirmation.missed_beats >= MAX_MISSED_BEATS
    assert aged.confirmation.until_s == -np.inf


def test_a_registration_in_flight_is_dropped_when_a_beat_contradicts_the_pose() -> None:
    records = tracked(Ultrasound(lambda t_s: shifted(t_s - 10.5))).history.registrations
    meanwhile = [r for r in records if r.refused and r.refused.cause is Refusal.SUSPENDED_MEANWHILE]
    assert len(meanwhile) == 1
    assert 38.0 < meanwhile[0].asked_s < 42.0


def test_a_new_pose_is_moved_to_at_a_bounded_speed() -> None:
    """Whatever updates follow one another: between two events the pose goes on from where it is."""
    motions: list[PoseMotion] = []

    def observe(tracker: PoseTracker) -> None:
        if tracker.motion is not None and (not motions or tracker.motion is not motions[-1]):
            motions.append(tracker.motion)

    tracked(Ultrasound(drifting), 48.0, observe=observe)
    assert len(motions) > 20
    for before, after in pairwise(motions):
        apart_mm = mean_displacement_mm(before.at(after.start_s), after.at(after.start_s), CENTER)
        assert apart_mm < 1e-9
        moved_mm = mean_displacement_mm(after.start, after.end, CENTER)
        assert moved_mm <= UPDATE_MM_PER_S * (after.end_s - after.start_s) + 1e-9


# ------------------------------------------------------------------ work


def test_frames_are_gathered_when_they_have_arrived_and_the_result_is_taken_when_it_is_due() -> None:
    ultrasound = Ultrasound()
    history = tracked(ultrasound, 13.0).history
    (record,) = history.registrations
    assert ultrasound.requests[0].until_s == FIRST_REGISTRATION_S == record.asked_s
    assert ultrasound.known_s == [FIRST_REGISTRATION_S + GATHER_S]
    assert record.ready_s == FIRST_REGISTRATION_S + COMPUTE_S
    assert history.updates[0].from_s >= record.ready_s


def test_late_work_is_polled_until_it_is_finished() -> None:
    ultrasound = Ultrasound(seconds=[5.005])
    tracker = tracked(ultrasound, 15.0)
    (record,) = tracker.history.registrations
    assert FIRST_REGISTRATION_S + 5.005 <= record.ready_s <= FIRST_REGISTRATION_S + 5.005 + POLL_S
    assert record.usable
    assert tracker.in_use is not None
    polls = np.diff([t for t in ultrasound.jobs[0].polls if t < record.ready_s])
    np.testing.assert_allclose(polls, POLL_S)


@pytest.mark.parametrize("seconds", [5.0, LATEST_S + 0.5])
def test_nothing_begins_in_the_past_after_late_work(seconds: float) -> None:
    ultrasound = Ultrasound(seconds=[seconds], failing=(0,))
    late, again = tracked(ultrasound, 30.0).history.registrations[:2]
    assert again.asked_s >= late.ready_s
    assert (np.diff(ultrasound.stepped_s) >= 0).all()


def test_a_result_that_comes_too_late_is_dropped() -> None:
    ultrasound = Ultrasound(seconds=[LATEST_S + 0.5])
    late, *others = tracked(ultrasound, 30.0).history.registrations
    assert late.asked_s + LATEST_S <= late.ready_s <= late.asked_s + LATEST_S + POLL_S
    assert late.reason == "not finished in time"
    assert late.result is None
    assert not late.usable
    assert not ultrasound.jobs[0].taken
    assert others[0].usable


def test_a_registration_that_fails_is_recorded_with_its_sentence_and_repeated() -> None:
    tracker = tracked(Ultrasound(failing=(0, 1)), 28.0)
    first, second, third = tracker.history.registrations[:3]
    assert first.reason == second.reason == "the images are black"
    assert not first.usable
    assert second.asked_s == max(first.asked_s + RETRY_S, first.ready_s)
    assert third.usable
    assert tracker.in_use is not None


def test_a_failure_leaves_the_pose_in_use_alone() -> None:
    history = tracked(Ultrasound(failing=tuple(range(1, 10))), 40.0).history
    assert [record.usable for record in history.registrations[:3]] == [True, False, False]
    assert all(update.pose is not None for update in history.updates)


def step_until(tracker: PoseTracker, until_s: float) -> None:
    while tracker.next_s < until_s:
        tracker.step()


def test_a_pose_in_use_is_registered_again_at_once_where_frames_are_understood_better() -> None:
    ultrasound = Ultrasound()
    tracker = tracked(ultrasound, 40.0)
    step_until(tracker, 41.0)
    assert tracker.next_s > 42.0
    tracker.renew(42.0)
    step_until(tracker, 43.0)
    assert ultrasound.requests[-1].until_s == 42.0


def test_slow_beats_are_compared_in_order_of_time_or_not_at_all() -> None:
    """On a machine that falls behind, a beat that is long past is no evidence of the pose now."""
    ultrasound = Ultrasound(beat_seconds=0.7)
    assert tracked(ultrasound, 30.0).in_use is not None
    assert (np.diff(ultrasound.stepped_s) >= 0).all()
    assert not tracked(Ultrasound(beat_seconds=2.0)).history.beats


# ------------------------------------------------------------------ landmarks


POINTS = CENTER + np.array(
    [[40.0, 0, 0], [0, 35.0, 5.0], [0, -10.0, 50.0], [-30.0, 5.0, 8.0], [5.0, -40.0, 9.0]]
)


def touched_at(t_s: float, pose: Rigid) -> tuple[Landmark, ...]:
    tracker_mm = pose.inverse().apply_array(POINTS)
    return tuple(
        Landmark(t_s, f"p{k}", m, p) for k, (m, p) in enumerate(zip(POINTS, tracker_mm, strict=True))
    )


MARKS = touched_at(1.0, HOME)


def with_prior(ultrasound: Ultrasound, from_s: float, until_s: float = np.inf) -> set[bool]:
    """Whether landmarks take part in the registrations requested in that time."""
    return {
        r.prior is not None and r.prior.in_search
        for r in ultrasound.requests
        if from_s <= r.until_s < until_s
    }


def test_landmarks_start_the_first_registration_and_take_part_in_it() -> None:
    ultrasound = Ultrasound()
    tracked(ultrasound, 13.0, start=None, landmarks=MARKS)
    request = ultrasound.requests[0]
    np.testing.assert_allclose(request.start.matrix, HOME.matrix, atol=1e-9)
    assert not request.warm
    assert request.prior is not None


def test_landmarks_do_not_pull_if_the_operator_gave_a_start() -> None:
    ultrasound = Ultrasound()
    tracked(ultrasound, 13.0, landmarks=MARKS)
    assert ultrasound.requests[0].start is HOME
    prior = ultrasound.requests[0].prior
    assert prior is not None
    assert not prior.in_search


def test_landmarks_that_were_touched_before_a_suspension_pull_no_more() -> None:
    """A shift at 30 s: until then they take part, afterwards only those that are touched again."""
    ultrasound = Ultrasound(shifted)
    tracker = tracked(ultrasound, 45.0, start=None, landmarks=MARKS)
    suspended_s = next(u.from_s for u in tracker.history.updates if u.pose is None)
    assert 30.0 < suspended_s < 33.0
    assert with_prior(ultrasound, 0.0, suspended_s) == {True}
    assert with_prior(ultrasound, suspended_s) == {False}
    again, there = Ultrasound(shifted), pose_at(shifted, 40.0)
    tracked(again, 45.0, start=None, landmarks=(*MARKS, *touched_at(suspended_s + 0.5, there)))
    assert with_prior(again, suspended_s + 0.5) == {True}
    prior = again.requests[-1].prior
    assert prior is not None
    np.testing.assert_allclose(prior.source.xyz_mm, there.inverse().apply_array(POINTS), atol=1e-9)


def test_landmarks_pull_no_more_once_registrations_refuse_themselves() -> None:
    """Two refusals in a row suspend the pose in use; the images may be right and the landmarks stale."""
    ultrasound = Ultrasound(refused_from_s=20.0)
    history = tracked(ultrasound, start=None, landmarks=MARKS).history
    suspended_s, doubt = next((u.from_s, u.doubt) for u in history.updates if u.pose is None)
    assert doubt is not None
    assert doubt.cause is DoubtCause.REFUSED
    assert with_prior(ultrasound, 0.0, suspended_s) == {True}
    assert with_prior(ultrasound, suspended_s) == {False}


def test_landmarks_pull_no_more_once_no_beat_has_confirmed_the_pose_for_long() -> None:
    ultrasound = Ultrasound(blind_from_s=20.0)
    tracked(ultrasound, start=None, landmarks=MARKS)
    assert with_prior(ultrasound, 0.0, 20.0) == {True}
    assert with_prior(ultrasound, 20.0 + MAX_AGE_S + RR_S) == {False}


def test_landmarks_elsewhere_keep_a_first_pose_from_use() -> None:
    off = PoseChart(HOME, CENTER).pose(np.array([0.0, 0.0, 0.0, 9.0, 0.0, 0.0]))
    history = tracked(Ultrasound(), 20.0, start=None, landmarks=touched_at(1.0, off)).history
    assert not history.updates
    refused = [record.refused for record in history.registrations]
    assert refused
    assert all(r is not None and r.cause is Refusal.LANDMARKS_DISAGREE for r in refused)
    assert "9.0 mm" in history.registrations[0].reason
