"""The heart's pose from moment to moment: finished work becomes events of its states, in order of time.

    first      a registration from the start pose, repeated until the beats that follow agree with one
    in use     each beat is compared with the pose and updates it; from time to time it is registered again
    suspended  no force; a registration from frames after the disturbance, and the beats that confirm it

Its states are in `pose_states`, their changes in `pose_transition`, requests in `registration_plan`, jobs in
`work`.
"""

from dataclasses import replace
from math import inf

from dvf_ig.cardiac import RPeak
from dvf_ig.core import FloatArray, PoseMotion, Rigid, TouchedPoints, WarpMotion
from dvf_ig.registration import PoseEstimate, RegistrationResult, TipSighting
from dvf_ig.registration.unfollowed_breathing import LEAST_BEATS

from .beat_evaluation import BeatEvaluation, ComparableBeat, evaluation_of
from .breathing import BreathingTracker
from .events import Landmark
from .history import RegistrationDecision, SessionHistory
from .pose_states import Candidate, Confirmation, InUse, NoPose, Pose, last_used, suspended, under_test
from .pose_transition import (
    BeatCompared,
    BeatMissed,
    BreathFollowed,
    PoseEvent,
    Registered,
    RegisterNext,
    RegistrationRefused,
    TipSeen,
    next_pose,
    retry_after,
)
from .reasons import Doubt, Refusal, Refused
from .registration_plan import RegistrationPlan
from .work import FinishedBeat, FinishedRegistration, UltrasoundSource, WorkQueue

REMEMBERED_BEATS = LEAST_BEATS
"""Last beats: a new candidate is compared with those that began after its frames, and the first one also with
those before, as many as exclude breathing."""


class PoseTracker:
    """The state of the pose, the plan and the work that bring it about; see the module docstring.

    Args:
        source: the ultrasound that has arrived.
        start: coarse pose that the first registrations begin at; None takes that of touched landmarks.
        history: gets an entry for everything that happens.
        lag_s: t_tracker(event) = t_video + lag_s.
        breathing: learns from the beats; None if nothing follows the breath.
        touched: points touched on the heart's surface before; None without any.
    """

    def __init__(
        self,
        source: UltrasoundSource,
        start: Rigid | None,
        history: SessionHistory,
        lag_s: float = 0.0,
        breathing: BreathingTracker | None = None,
        touched: TouchedPoints | None = None,
    ) -> None:
        self._use(NoPose())
        self.history = history
        self._plan = RegistrationPlan(start, touched)
        self._work = WorkQueue(source, lag_s)
        self._breathing = breathing
        self._recent: list[ComparableBeat] = []
        self._stepped_s = -inf

    @property
    def in_use(self) -> PoseEstimate | None:
        """The pose that forces depend on."""
        return self.pose.estimate if isinstance(self.pose, InUse) else None

    def _use(self, pose: Pose) -> None:
        """Enter a state; what each tick asks of it is found once."""
        last, before = last_used(pose), suspended(pose)
        self.pose: Pose = pose
        self.motion: PoseMotion | None = pose.motion if isinstance(pose, InUse) else None
        """The pose in use over time; None while no pose may be used."""
        self.warp: WarpMotion | None = pose.warp if isinstance(pose, InUse) else None
        """Change of the heart's shape over time, at that pose; None of a heart that has kept its shape."""
        self.estimate: PoseEstimate | None = None if last is None else last.estimate
        """The pose in use, or the last one while none is; None before the first."""
        self.confirmation: Confirmation | None = None if last is None else last.confirmation
        """The last beat that confirmed that pose."""
        self.doubt: Doubt | None = None if before is None else before.doubt
        """Evidence that suspended the pose; None while one is in use, or before the first."""

    def covariance_mm2(self, now_s: float) -> FloatArray | None:
        """(6, 6) of the pose in use or the last one, as σ_d takes it; None before the first."""
        last = last_used(self.pose)
        if isinstance(last, InUse):
            return last.covariance_mm2(now_s)
        return None if last is None else last.estimate.total_mm2

    @property
    def next_s(self) -> float:
        """When something is to be done next, never before the last step; infinite if nothing is."""
        return max(self._stepped_s, min(self._plan.at_s, self._work.next_s))

    def begin(self, event_s: float) -> None:
        """Begin with the first frame, whose image shows what happened at `event_s`."""
        self._plan.begin(event_s)

    def add_peak(self, peak: RPeak) -> None:
        """Add an R peak that was detected, and the beat that ended with it."""
        self._work.add_peak(peak)

    def add_landmark(self, landmark: Landmark) -> None:
        """Add a landmark that was touched."""
        self._plan.add_landmark(landmark)

    def add_tip(self, seen: TipSighting, now_s: float) -> None:
        """Add a sighting of the tool's tip in images up to now."""
        self.history.append(seen)
        self._apply(TipSeen(now_s, seen))

    def follow_breath(self, now_s: float) -> None:
        """Register again, now that the breath is followed."""
        self._recent.clear()
        self._apply(BreathFollowed(now_s))

    def renew(self, now_s: float) -> None:
        """Register again, now that frames of the whole breath can be moved to rest."""
        if self.in_use is not None:
            self._plan.change(RegisterNext(now_s))

    def step(self) -> None:
        """Do what is to be done at `next_s`."""
        self._stepped_s = now_s = self.next_s
        registration = self._work.take_registration(now_s)
        if registration is not None:
            self._take_registration(registration, now_s)
        elif self._plan.at_s <= now_s:
            request = self._plan.request(now_s, self.pose, self._work.peaks)
            if request is not None:
                self._work.register(request)
        else:
            beat = self._work.advance(now_s, under_test(self.pose), in_use=isinstance(self.pose, InUse))
            if beat is not None:
                self._take_beat(beat, now_s)

    def _apply(self, event: PoseEvent) -> None:
        """Change the state, and carry out the actions that follow."""
        before = self.pose
        pose, actions = next_pose(before, event)
        self._use(pose)
        if isinstance(before, InUse) and not isinstance(self.pose, InUse) and self._breathing is not None:
            since_s = 0.0 if self.doubt is None else self.doubt.since_s
            self._breathing.shifted(since_s if since_s > 0.0 else inf)
        for action in actions:
            if not isinstance(action, RegisterNext):
                self.history.append(action)
                continue
            self._plan.change(action)
            if action.cancel_running:
                self._work.cancel_registrations()

    # ------------------------------------------------------------------ finished work

    def _take_registration(self, finished: FinishedRegistration, now_s: float) -> None:
        record = finished.record
        self.history.append(record)
        if finished.cancelled:
            self.history.append(RegistrationDecision(record, Refused(Refusal.SUSPENDED_MEANWHILE)))
        elif record.result is None or record.frames is None:
            self._plan.change(retry_after(record.asked_s, now_s))
        elif not (record.usable or (isinstance(self.pose, InUse) and record.renews)):
            self._apply(RegistrationRefused(now_s, record.asked_s, record.result.stop))
        else:
            middle_s = float(record.frames.event_s[record.frames.used].mean())
            beats = sum(middle_s < peak.t_s < now_s for peak in self._work.peaks)
            estimate = _estimate_of(record.result)
            landmarks = self._plan.landmarks.fit_through(estimate.warp)
            self._apply(Registered(now_s, record, estimate, beats, landmarks))
            self._watch_recent(estimate, record.asked_s, now_s)
            self._compare_recent(estimate, record.asked_s, now_s)

    def _watch_recent(self, candidate: PoseEstimate, asked_s: float, now_s: float) -> None:
        """Look for breathing in the beats of a first candidate's frames, so that force need not wait."""
        if self._breathing is None or not self._breathing.watches or under_test(self.pose) is not candidate:
            return
        for beat in [beat for beat in self._recent if beat.begin_s < asked_s]:
            evaluation = self._evaluate(beat, candidate)
            if evaluation is not None:
                self._watch_breathing(evaluation, now_s)

    def _watch_breathing(self, evaluation: BeatEvaluation, now_s: float) -> None:
        if self._breathing is not None:
            middle_s = 0.5 * (evaluation.begin_s + evaluation.end_s)
            self._breathing.watch(middle_s, now_s, evaluation.measurement, evaluation.view_mm)

    def _compare_recent(self, candidate: PoseEstimate, asked_s: float, now_s: float) -> None:
        """Compare a new candidate with the beats that ended after its frames, until one contradicts it."""
        if not isinstance(self.pose, Candidate) or self.pose.estimate is not candidate:
            return
        for beat in [beat for beat in self._recent if beat.begin_s >= asked_s]:
            estimate = under_test(self.pose)
            if estimate is not None and (isinstance(self.pose, InUse) or estimate is candidate):
                self._take_evaluation(self._evaluate(beat, estimate), now_s, again=True)

    def _take_beat(self, finished: FinishedBeat, now_s: float) -> None:
        """Take a beat's evaluation; evaluate it again if another pose is under test by now."""
        compared, estimate = finished.compared, under_test(self.pose)
        evaluation = compared.evaluation
        if compared.breathing is not None and self._breathing is not None:
            self._breathing.add_beat(compared.breathing.measurement, compared.breathing.frames)
        if compared.slices is not None:
            self._recent = [*self._recent[1 - REMEMBERED_BEATS :], compared.slices]
        if estimate is None:
            return
        if compared.slices is not None and finished.tested is not estimate:
            evaluation = self._evaluate(compared.slices, estimate)
        if evaluation is None and not compared.irregular:
            self._apply(BeatMissed())
        self._take_evaluation(evaluation, now_s)

    def _evaluate(self, beat: ComparableBeat, estimate: PoseEstimate) -> BeatEvaluation | None:
        return evaluation_of(beat, estimate, in_use=isinstance(self.pose, InUse))

    def _take_evaluation(
        self, evaluation: BeatEvaluation | None, now_s: float, *, again: bool = False
    ) -> None:
        if evaluation is None:
            return
        self._watch_breathing(evaluation, now_s)
        evaluation = replace(evaluation, in_use=isinstance(self.pose, InUse))
        self.history.append(replace(evaluation, shape=None))  # a history keeps no covariances of shapes
        if not isinstance(self.pose, Candidate):
            self._plan.follow_beat(evaluation.measurement.best)
        self._apply(BeatCompared(now_s, evaluation, again))


def _estimate_of(result: RegistrationResult) -> PoseEstimate:
    change = result.shape
    return PoseEstimate.from_registration(
        result.target_from_source,
        result.covariance,
        result.noise_covariance,
        result.center_mm,
        result.matched,
        None if change is None or change.followed is None else change,
        None if result.coverage is None else result.coverage.surface_mm,
    )
