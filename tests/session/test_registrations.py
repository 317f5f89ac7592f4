"""Registrations in a session: late ones, failed ones, and what touched landmarks have to say in them."""

from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np
import pytest
from dvf_ig.session.pose.registration_jobs import COMPUTE_S, GATHER_S, LATEST_S, POLL_S
from dvf_ig.session.pose.registration_monitor import RegistrationMonitor
from known_patient import DETECTION_S, KnownBeat, Patient, registration, still

from dvf_ig.cardiac import RPeak
from dvf_ig.core import FloatArray, Rigid, Stop
from dvf_ig.registration import Gated, PoseChart
from dvf_ig.session import Landmark, Refusal, SessionHistory
from dvf_ig.session.beat_evaluation import ComparedBeat
from dvf_ig.session.gated_frames import GatedFrames
from dvf_ig.session.pose_states import MAX_AGE_S
from dvf_ig.session.pose_tracker import FIRST_ATTEMPT_S, RETRY_S, PoseTracker
from dvf_ig.session.reasons import DoubtCause
from dvf_ig.session.ultrasound_registration import RegistrationRecord, RegistrationRequest
from dvf_ig.session.work import Job, answered

T = TypeVar("T")
CENTER = np.array([10.0, -20.0, 30.0])
HOME = Rigid.from_rotation_vector([0.2, -0.1, 0.4], [5.0, 6.0, -7.0], "mr", "tracker")
RR_S = 0.8


@dataclass
class Simulated(Generic[T]):
    """Work that is done at a time of the events, on a clock that the test sets."""

    clock: "Clock"
    ready_s: float
    value: T
    asked: list[float] = field(default_factory=list)
    taken: bool = False

    def done(self) -> bool:
        self.asked.append(self.clock.now_s)
        return self.clock.now_s >= self.ready_s

    def result(self) -> T:
        self.taken = True
        return self.value


@dataclass
class Clock:
    now_s: float = 0.0


@dataclass
class Ultrasound:
    """Ultrasound of a known patient, whose registrations take `seconds` each, or fail."""

    patient: Patient
    clock: Clock = field(default_factory=Clock)
    seconds: list[float] = field(default_factory=list)
    beat_seconds: float = 0.0
    refused_from_s: float = np.inf
    blind_from_s: float = np.inf
    failures: list[str] = field(default_factory=list)
    requests: list[RegistrationRequest] = field(default_factory=list)
    known_s: list[float] = field(default_factory=list)
    stepped_s: list[float] = field(default_factory=list)
    jobs: list[Simulated[RegistrationRecord]] = field(default_factory=list)

    def register(self, request: RegistrationRequest, known_s: float) -> Job[RegistrationRecord]:
        self.requests.append(request)
        self.known_s.append(known_s)
        event_s = np.arange(request.from_s, request.until_s, 1 / 12)
        n, index = len(event_s), np.arange(len(event_s), dtype=np.int64)
        turns = np.tile(np.eye(3), (n, 1, 1))
        frames = GatedFrames(0, 0, Gated(index, {}), index, event_s, np.zeros(n), turns, np.zeros((n, 3)))
        mean = np.mean([self.patient(t) for t in event_s], axis=0)
        found = request.record(frames, registration(PoseChart(HOME, CENTER).pose(mean), CENTER))
        if request.until_s > self.refused_from_s and found.result is not None:
            found = replace(found, result=replace(found.result, stop=Stop.POOR_MATCH))
        if self.failures:
            found = request.record(frames, failure=self.failures.pop(0))
        seconds = self.seconds.pop(0) if self.seconds else 0.0
        self.jobs.append(Simulated(self.clock, request.until_s + seconds, found))
        return self.jobs[-1]

    def beat(
        self, peaks: tuple[RPeak, ...], known_s: float, pose: Rigid | None, *, in_use: bool
    ) -> Job[ComparedBeat]:
        begin_s, end_s = peaks[-2].t_s, peaks[-1].t_s
        if begin_s > self.blind_from_s:
            return answered(ComparedBeat(None, None, irregular=False))
        there = PoseChart(HOME, CENTER).pose(self.patient((begin_s + end_s) / 2))
        beat = KnownBeat(begin_s, end_s, there)
        compared = None if pose is None else beat.evaluate_beat(pose, CENTER, in_use=in_use)
        done = ComparedBeat(beat, compared, irregular=False)
        return (
            Simulated(self.clock, known_s + self.beat_seconds, done) if self.beat_seconds else answered(done)
        )


def tracked(
    ultrasound: Ultrasound,
    until_s: float,
    *,
    start: Rigid | None = HOME,
    landmarks: tuple[Landmark, ...] = (),
) -> PoseTracker:
    """Everything that happens until then."""
    tracker = PoseTracker(ultrasound, RegistrationMonitor(CENTER, None), start, SessionHistory())
    tracker.begin(0.0)
    peaks = [RPeak(RR_S * k, RR_S * k + DETECTION_S, 1.0) for k in range(round(until_s / RR_S))]
    inputs = [(p.detected_at_s, p) for p in peaks] + [(m.t_s, m) for m in landmarks]
    for at_s, event in sorted(inputs, key=lambda one: one[0]):
        while tracker.next_s < at_s:
            ultrasound.clock.now_s = tracker.next_s
            ultrasound.stepped_s.append(tracker.next_s)
            tracker.step()
        if isinstance(event, RPeak):
            tracker.add_peak(event)
        else:
            tracker.add_landmark(event)
    return tracker


def test_frames_are_gathered_when_they_have_arrived_and_the_result_is_taken_when_it_is_due() -> None:
    ultrasound = Ultrasound(still)
    tracker = tracked(ultrasound, 13.0)
    (attempt,) = tracker.history.registrations
    assert ultrasound.requests[0].until_s == FIRST_ATTEMPT_S == attempt.asked_s
    assert ultrasound.known_s == [FIRST_ATTEMPT_S + GATHER_S]
    assert attempt.ready_s == FIRST_ATTEMPT_S + COMPUTE_S
    assert tracker.history.updates[0].from_s >= attempt.ready_s


def test_work_that_is_late_is_asked_for_again_until_it_is_done() -> None:
    ultrasound = Ultrasound(still, seconds=[5.005])
    tracker = tracked(ultrasound, 15.0)
    (attempt,) = tracker.history.registrations
    assert FIRST_ATTEMPT_S + 5.005 <= attempt.ready_s <= FIRST_ATTEMPT_S + 5.005 + POLL_S
    assert attempt.usable
    assert tracker.monitor.in_use is not None
    waits = np.diff([t for t in ultrasound.jobs[0].asked if t < attempt.ready_s])
    np.testing.assert_allclose(waits, POLL_S)


@pytest.mark.parametrize("seconds", [5.0, LATEST_S + 0.5])
def test_nothing_begins_in_the_past_after_late_work(seconds: float) -> None:
    """A registration is asked for, and its frames are gathered, at moments in order."""
    ultrasound = Ultrasound(still, seconds=[seconds], failures=["the images are black"])
    tracker = tracked(ultrasound, 30.0)
    late, again = list(tracker.history.registrations)[:2]
    assert again.asked_s >= late.ready_s
    assert (np.diff(ultrasound.stepped_s) >= 0).all()


def test_a_result_that_comes_too_late_is_dropped() -> None:
    ultrasound = Ultrasound(still, seconds=[LATEST_S + 0.5])
    tracker = tracked(ultrasound, 30.0)
    late, *others = tracker.history.registrations
    assert late.asked_s + LATEST_S <= late.ready_s <= late.asked_s + LATEST_S + POLL_S
    assert late.reason == "not finished in time"
    assert late.result is None
    assert not late.usable
    assert not ultrasound.jobs[0].taken
    assert others[0].usable


def test_a_registration_that_fails_is_recorded_with_its_sentence_and_repeated() -> None:
    ultrasound = Ultrasound(still, failures=["the images are black", "the images are black"])
    tracker = tracked(ultrasound, 28.0)
    first, second, third = list(tracker.history.registrations)[:3]
    assert first.reason == second.reason == "the images are black"
    assert not first.usable
    assert second.asked_s == max(first.asked_s + RETRY_S, first.ready_s)
    assert third.usable
    assert tracker.monitor.in_use is not None


def test_a_failure_leaves_the_pose_in_use_alone() -> None:
    ultrasound = Ultrasound(still)
    tracker = tracked(ultrasound, 13.0)
    assert tracker.monitor.in_use is not None
    ultrasound = Ultrasound(still)
    ultrasound.failures = []
    original = ultrasound.register

    def second_fails(request: RegistrationRequest, known_s: float) -> Job[RegistrationRecord]:
        if ultrasound.requests:
            ultrasound.failures = ["no"]
        return original(request, known_s)

    ultrasound.register = second_fails  # type: ignore[method-assign]
    tracker = tracked(ultrasound, 40.0)
    assert [a.usable for a in list(tracker.history.registrations)[:3]] == [True, False, False]
    assert all(update.pose is not None for update in tracker.history.updates)


def test_beats_that_wait_for_one_another_are_compared_in_order_of_time() -> None:
    ultrasound = Ultrasound(still, beat_seconds=1.0)
    tracked(ultrasound, 30.0)
    assert (np.diff(ultrasound.stepped_s) >= 0).all()


def test_a_beat_that_is_never_compared_is_given_up() -> None:
    tracker = tracked(Ultrasound(still, beat_seconds=1e6), 60.0)
    assert len(tracker._beats) < 10


def test_beats_that_are_compared_too_slowly_confirm_nothing() -> None:
    """On a machine that falls behind, a beat that is long past says nothing of the pose now."""
    tracker = tracked(Ultrasound(still, beat_seconds=2.0), 60.0)
    if tracker.confirmation is not None and tracker.history.beats:
        assert tracker.confirmation.confirmed_s - tracker.history.beats[-1].end_s < MAX_AGE_S


# ------------------------------------------------------------------ landmarks


POINTS = CENTER + np.array(
    [[40.0, 0, 0], [0, 35.0, 5.0], [0, -10.0, 50.0], [-30.0, 5.0, 8.0], [5.0, -40.0, 9.0]]
)


def touched_at(t_s: float, pose: Rigid) -> tuple[Landmark, ...]:
    tracker_mm = pose.inverse().apply_array(POINTS)
    return tuple(
        Landmark(t_s, f"p{k}", m, p) for k, (m, p) in enumerate(zip(POINTS, tracker_mm, strict=True))
    )


def shifted(t_s: float) -> FloatArray:
    return np.array([1.0, 0.0, -1.5, 5.0, -4.0, 4.0]) * min(1.0, max(0.0, (t_s - 30.0) / 0.5))


def test_landmarks_start_the_first_registration_and_take_part_in_it() -> None:
    ultrasound = Ultrasound(still)
    tracked(ultrasound, 13.0, start=None, landmarks=touched_at(1.0, HOME))
    request = ultrasound.requests[0]
    np.testing.assert_allclose(request.start.matrix, HOME.matrix, atol=1e-9)
    assert not request.warm
    assert request.prior is not None


def test_landmarks_do_not_pull_where_the_operator_gave_a_start() -> None:
    ultrasound = Ultrasound(still)
    tracked(ultrasound, 13.0, landmarks=touched_at(1.0, HOME))
    assert ultrasound.requests[0].start is HOME
    assert ultrasound.requests[0].prior is None


def test_landmarks_that_were_touched_before_a_doubt_pull_no_more() -> None:
    """A shift at 30 s: until then they take part, afterwards only those that are touched again."""
    ultrasound = Ultrasound(shifted)
    tracker = tracked(ultrasound, 45.0, start=None, landmarks=touched_at(1.0, HOME))
    doubted_s = next(u.from_s for u in tracker.history.updates if u.pose is None)
    assert 30.0 < doubted_s < 33.0
    before = [r.prior for r in ultrasound.requests if r.until_s < doubted_s]
    after = [r.prior for r in ultrasound.requests if r.until_s >= doubted_s]
    assert before
    assert all(prior is not None for prior in before)
    assert after
    assert all(prior is None for prior in after)
    again = Ultrasound(shifted)
    there = PoseChart(HOME, CENTER).pose(shifted(40.0))
    marks = (*touched_at(1.0, HOME), *touched_at(doubted_s + 0.5, there))
    tracked(again, 45.0, start=None, landmarks=marks)
    late = [r for r in again.requests if r.until_s >= doubted_s + 0.5]
    assert late
    assert all(r.prior is not None for r in late)
    prior = late[0].prior
    assert prior is not None
    np.testing.assert_allclose(prior.source.xyz_mm, there.inverse().apply_array(POINTS), atol=1e-9)


def test_landmarks_pull_no_more_once_registrations_refuse_themselves() -> None:
    """Two refusals in a row suspend the pose in use; the images may be right and the landmarks stale."""
    ultrasound = Ultrasound(still, refused_from_s=20.0)
    tracker = tracked(ultrasound, 60.0, start=None, landmarks=touched_at(1.0, HOME))
    doubted_s, doubt = next((u.from_s, u.doubt) for u in tracker.history.updates if u.pose is None)
    assert doubt is not None
    assert doubt.cause is DoubtCause.REFUSED
    before = [r.prior for r in ultrasound.requests if r.until_s < doubted_s]
    after = [r.prior for r in ultrasound.requests if r.until_s >= doubted_s]
    assert before
    assert all(prior is not None for prior in before)
    assert after
    assert all(prior is None for prior in after)


def test_landmarks_pull_no_more_once_no_beat_has_confirmed_the_pose_for_long() -> None:
    ultrasound = Ultrasound(still, blind_from_s=20.0)
    tracked(ultrasound, 60.0, start=None, landmarks=touched_at(1.0, HOME))
    before = [r.prior for r in ultrasound.requests if r.until_s < 20.0]
    after = [r.prior for r in ultrasound.requests if r.until_s > 20.0 + MAX_AGE_S + RR_S]
    assert all(prior is not None for prior in before)
    assert after
    assert all(prior is None for prior in after)


def test_landmarks_elsewhere_keep_a_first_pose_from_use() -> None:
    off = PoseChart(HOME, CENTER).pose(np.array([0.0, 0.0, 0.0, 9.0, 0.0, 0.0]))
    tracker = tracked(Ultrasound(still), 20.0, start=None, landmarks=touched_at(1.0, off))
    assert not tracker.history.updates
    refused = [a.refused for a in tracker.history.registrations]
    assert refused
    assert all(r is not None and r.cause is Refusal.LANDMARKS_DISAGREE for r in refused)
    assert "9.0 mm" in tracker.history.registrations[0].reason
