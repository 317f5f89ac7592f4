"""The heart's pose from moment to moment: registrations now and then, and every beat in between.

    first      a registration from the start pose, repeated until the beats that follow agree with one
    in use     each beat is compared with the pose and updates it; a registration now and then besides
    suspended  no force; a registration from frames after the disturbance, and the beats that confirm it

Everything happens in time order. Frames are gathered a moment after a registration was asked for or a beat
ended, when all of them have arrived; a registration takes effect COMPUTE_S after it was asked for, a beat
BEAT_COMPUTE_S after its R peak was detected, or as soon afterwards as the executor has done.
"""

from dataclasses import replace
from math import inf

from dvf_ig.cardiac import RPeak
from dvf_ig.core import PoseMotion, Rigid, Stop
from dvf_ig.registration import PoseEstimate, TipSighting
from dvf_ig.session.events import Landmark
from dvf_ig.session.refusal import Refusal, Refused
from dvf_ig.session.ultrasound.beat_evaluation import BeatEvaluation, ComparableBeat, as_of, evaluation_of
from dvf_ig.session.ultrasound.frame_registration import RegistrationRecord, RegistrationRequest
from dvf_ig.session.ultrasound.ultrasound_source import UltrasoundSource

from .beat_jobs import BeatJobs, FinishedBeat
from .confirmation import Confirmation
from .history import PoseUpdate, SessionHistory
from .registration_jobs import RegistrationJobs
from .registration_monitor import RegistrationMonitor, confirms
from .touched_landmarks import TouchedLandmarks

FIRST_ATTEMPT_S = 8.0
"""The first registration is asked for when there are so many seconds of ultrasound."""
RETRY_S = 4.0
"""Least time between two registrations; one that gave no pose is repeated after it."""
REFRESH_S = 12.0
"""A pose in use is registered anew after so many seconds at most."""
RECOVER_S = 3.0
"""A suspended pose is registered anew when frames of this long after the disturbance are at hand."""
MEMORY_S = 12.0
"""How far back a registration looks: one refresh, so that a patient who moved is seen unmixed by the next."""
REMEMBERED_BEATS = 6
"""A registration that waits for confirmation is compared with so many beats that ended meanwhile."""


class PoseTracker:
    """The pose in use, and what is to happen to it next; see the module docstring.

    Args:
        source: the ultrasound that has arrived.
        monitor: what the pose is compared with.
        start: coarse pose that the first registrations begin at; None takes that of touched landmarks.
        history: is told what happens.
        lag_s: t_tracker(event) = t_video + lag_s.
    """

    def __init__(
        self,
        source: UltrasoundSource,
        monitor: RegistrationMonitor,
        start: Rigid | None,
        history: SessionHistory,
        lag_s: float = 0.0,
    ) -> None:
        self.monitor = monitor
        self.history = history
        self.motion: PoseMotion | None = None
        """The pose in use over time; None while no pose may be used."""
        self.confirmation: Confirmation | None = None
        self._start = start
        self._landmarks = TouchedLandmarks()
        self._frames_from_s = inf
        """Earlier frames show another pose."""
        self._next_start_s = inf
        self._registrations = RegistrationJobs(source, lag_s)
        self._beats = BeatJobs(source)
        self._recent: list[ComparableBeat] = []
        self._beat_pose: Rigid | None = None
        """The best pose of the last beat, from when one suspended the pose in use until a registration."""
        self._pending_asked_s = inf
        self._stepped_s = -inf

    @property
    def next_s(self) -> float:
        """When something is to be done next, never before the last step; infinite where nothing is."""
        return max(self._stepped_s, min(self._next_start_s, self._registrations.next_s, self._beats.next_s))

    def begin(self, event_s: float) -> None:
        """The first frame was recorded; its image shows what happened at `event_s`."""
        self._frames_from_s, self._next_start_s = event_s, event_s + FIRST_ATTEMPT_S

    def add_peak(self, peak: RPeak) -> None:
        """An R peak was detected, and a beat ended with it."""
        self._beats.add_peak(peak)

    def add_landmark(self, landmark: Landmark) -> None:
        """A landmark was touched."""
        self._landmarks.add(landmark)
        self.monitor = replace(self.monitor, landmarks=self._landmarks.fit)

    def add_tip(self, seen: TipSighting, now_s: float) -> None:
        """Images up to now show the tool's tip."""
        self.history.sightings.append(seen)
        before = self.monitor
        self.monitor = before.after_tip(seen)
        self._record_update(before, now_s)
        if before.in_use and not self.monitor.in_use:
            self._registrations.cancel()
            self._next_start_s = now_s + RECOVER_S

    def step(self) -> None:
        """Do what is to be done at `next_s`."""
        self._stepped_s = now_s = self.next_s
        if self._registrations.answer_due(now_s):
            registered = self._registrations.take_answer(now_s)
            if registered is not None:
                self._take_registration(registered, now_s)
        elif self._next_start_s <= now_s:
            self._ask_registration(now_s)
        elif self._registrations.next_s <= now_s:
            self._registrations.gather(now_s)
        else:
            in_use = self.monitor.in_use is not None
            beat = self._beats.step(now_s, self.monitor.under_test, in_use=in_use)
            if beat is not None:
                self._take_beat(beat, now_s)

    # ------------------------------------------------------------------ registrations

    def _ask_registration(self, now_s: float) -> None:
        self._next_start_s = inf
        start = self._registration_start()
        if start is None:
            self._next_start_s = now_s + RETRY_S
            return
        pose, warm = start
        held = self.confirmation
        if self.monitor.in_use and held is not None and now_s >= held.until_s:
            self._landmarks.forget(held.confirmed_s)
        since_s = max(self._frames_from_s, now_s - MEMORY_S)
        prior = None if self._start is not None else self._landmarks.prior
        request = RegistrationRequest(since_s, now_s, pose, warm, prior, self._beats.peaks)
        self._registrations.ask(request, now_s)

    def _registration_start(self) -> tuple[Rigid, bool] | None:
        """Where a registration begins, and whether that is relied on; None where nothing is known.

        Right after a suspension it is the last beat's best pose; once such a start has failed, displaced
        copies of the last pose are tried besides.
        """
        tested = self.monitor.under_test
        if tested is None:
            start = self._start or self._landmarks.fit
            return None if start is None else (start, False)
        if self.monitor.in_use:
            return tested.pose, True
        if self._beat_pose is not None:
            pose, self._beat_pose = self._beat_pose, None
            return pose, True
        return tested.pose, False

    def _take_registration(self, attempt: RegistrationRecord, now_s: float) -> None:
        self.history.attempts.append(attempt)
        if attempt.refused is not None:
            return
        self._next_start_s = max(now_s, attempt.asked_s + RETRY_S)
        if attempt.usable:
            self._take_pose(attempt, now_s)
        elif attempt.result is not None:
            self._take_refusal(attempt.result.stop, attempt.asked_s, now_s)

    def _take_pose(self, attempt: RegistrationRecord, now_s: float) -> None:
        """A registration whose own evidence allows its use meets the monitor."""
        result, frames = attempt.result, attempt.frames
        if result is None or frames is None:
            return
        middle_s = float(frames.event_s[frames.used].mean())
        beats = sum(middle_s < p.t_s < now_s for p in self._beats.peaks)
        found = PoseEstimate.from_registration(
            result.target_from_source,
            result.covariance,
            result.noise_covariance,
            result.center_mm,
            result.matched,
        )
        before = self.monitor
        self.monitor, refused = before.after_registration(found, beats)
        self.history.set_refused(attempt.asked_s, refused)
        self._record_update(before, now_s)
        if self.monitor.pending is found:
            if before.in_use:
                self._landmarks.forget()
            self._pending_asked_s = attempt.asked_s
            self._next_start_s = now_s + REFRESH_S
            for beat in [b for b in self._recent if b.begin_s >= attempt.asked_s]:
                if self.monitor.in_use or self.monitor.pending is found:
                    self._compare(beat, now_s)
        elif self.monitor.in_use:
            self._next_start_s = max(now_s, attempt.asked_s + self._refresh_s(attempt.asked_s))

    def _take_refusal(self, stop: Stop, asked_s: float, now_s: float) -> None:
        """A registration refused by its own evidence speaks against the pose in use."""
        before = self.monitor
        self.monitor = before.after_refusal(stop)
        self._record_update(before, now_s)
        if before.in_use and not self.monitor.in_use:
            self._landmarks.forget()
            self._frames_from_s = max(self._frames_from_s, asked_s)
            self._next_start_s = max(now_s, asked_s + RECOVER_S)

    def _refresh_s(self, asked_s: float) -> float:
        """A registration from little is repeated when there is twice as much."""
        return min(REFRESH_S, max(RETRY_S, asked_s - max(self._frames_from_s, asked_s - MEMORY_S)))

    # ------------------------------------------------------------------ beats

    def _take_beat(self, done: FinishedBeat, now_s: float) -> None:
        """A beat's evaluation; anew where another pose is under test by now."""
        before_s = None if self.confirmation is None else self.confirmation.confirmed_s
        slices = done.compared.slices
        if slices is not None:
            self._recent = [*self._recent[1 - REMEMBERED_BEATS :], slices]
            same = done.tested is self.monitor.under_test
            self._compare(slices, now_s, done.compared.evaluation if same else None, evaluated=same)
        held = self.confirmation
        if held is not None and held.confirmed_s == before_s and not done.compared.irregular:
            self.confirmation = held.missed()

    def _compare(
        self,
        beat: ComparableBeat,
        now_s: float,
        evaluation: BeatEvaluation | None = None,
        *,
        evaluated: bool = False,
    ) -> None:
        """Compare a beat with the pose under test, and draw the consequences."""
        before = self.monitor
        tested = before.under_test
        if tested is None:
            return
        in_use = before.in_use is not None
        if not evaluated:
            evaluation = evaluation_of(beat, tested, before.center_mm, in_use=in_use)
        elif evaluation is not None:
            evaluation = as_of(evaluation, tested)
        if evaluation is None:
            return
        evaluation = replace(evaluation, in_use=in_use)
        self.history.beats.append(evaluation)
        self.monitor = before.after_beat(evaluation)
        self._record_update(before, now_s)
        if self.monitor.in_use and confirms(evaluation.measurement):
            self.confirmation = Confirmation(now_s, self.monitor.in_use.tre_bound_mm)
        if before.in_use and not self.monitor.in_use:
            doubt = self.monitor.doubt
            elsewhere = None if doubt is None else doubt.pose
            self._suspend(beat.end_s, elsewhere or evaluation.measurement.best, now_s)
        elif before.pending is None and self._beat_pose is not None:
            self._beat_pose = evaluation.measurement.best
        elif before.pending and self.monitor.in_use:
            self._confirm(now_s)
        elif before.pending and self.monitor.pending is None:
            self._drop_pending(evaluation.measurement.moved_mm, now_s)

    def _suspend(self, end_s: float, beat_pose: Rigid, now_s: float) -> None:
        """Register anew from frames after the beat that contradicted the pose in use."""
        self._registrations.cancel()
        self._landmarks.forget()
        self._frames_from_s, self._beat_pose = end_s, beat_pose
        self._next_start_s = max(now_s, end_s + RECOVER_S)

    def _confirm(self, now_s: float) -> None:
        self.history.set_refused(self._pending_asked_s, None)
        asked_s = self._pending_asked_s
        self._next_start_s = max(now_s, asked_s + self._refresh_s(asked_s))

    def _drop_pending(self, off_mm: float, now_s: float) -> None:
        self.history.set_refused(self._pending_asked_s, Refused(Refusal.BEAT_DISAGREES, off_mm))
        self._next_start_s = max(now_s, self._pending_asked_s + RETRY_S)

    def _record_update(self, before: RegistrationMonitor, now_s: float) -> None:
        was, now = before.in_use, self.monitor.in_use
        if now is not was:
            if now is not None and self.confirmation is not None:
                self.confirmation = self.confirmation.changed(now.tre_bound_mm)
            doubt = None if now else self.monitor.doubt
            self.history.updates.append(PoseUpdate(now_s, now.pose if now else None, doubt))
            self._move(now, now_s)

    def _move(self, now: PoseEstimate | None, now_s: float) -> None:
        """The first pose is in use at once, for no force depends on one before; a later one is moved to."""
        if now is None:
            self.motion = None
        elif self.motion is None:
            self.motion = PoseMotion.still(now.pose)
            self.confirmation = Confirmation(now_s, now.tre_bound_mm)
        else:
            held = self.motion.at(now_s)
            self.motion = PoseMotion.towards(held, now.pose, now_s, self.monitor.center_mm)
