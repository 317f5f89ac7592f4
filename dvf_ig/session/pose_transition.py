"""The life of a pose: what leads from one of its states to the next, as one pure transition function.

    NoPose ──────── usable registration ─────────► Candidate
    Candidate ───── consistent heart beats ──────► InUse
    Candidate ───── a beat that contradicts it ──► NoPose, or the suspended pose before it
    InUse ───────── usable registration 2.5 mm away ► Candidate, with the pose in use suspended
    InUse ───────── contradicted by beats, registrations or the tool's tip ──► Suspended: no force
    Suspended ───── consistent heart beats ──────► InUse
    Suspended ───── usable registration ─────────► Candidate

A wrong probe calibration, a marker that slipped on the probe and a patient who moved all leave images that
match the model well at some pose. Still, the position is wrong: landmarks touched with another tool disagree
at once, the next heart beat matches better at another pose, and after a slip no pose fits the views of
several beats. Beats contradict a pose if the last of them, together, put the heart elsewhere
(`ShiftDetector`), or if single ones fit another pose far better.
"""

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from dvf_ig.core import HEART_RADIUS_MM, PoseMotion, Rigid, Stop, WarpMotion, mean_displacement_mm
from dvf_ig.registration import (
    TARGET_RADIUS_MM,
    BeatMeasurement,
    PoseEstimate,
    TipSighting,
    landmarks_disagree,
)

from .beat_evaluation import BeatEvaluation
from .history import PoseUpdate, RegistrationDecision
from .pose_states import Candidate, Confirmation, InUse, NoPose, Pose, Suspended, Trial, Waiting, suspended
from .reasons import Doubt, DoubtCause, Refusal, Refused
from .ultrasound_registration import RegistrationRecord

JUMP_MM = 2.5
"""Repeated registrations of an undisturbed patient move by up to 1.2 mm."""
SHIFT_LIMIT = 45.0
"""Statistic of `ShiftDetector` that suspends the pose in use: at most one false alarm in an hour of beats
(4320) even if all images are poor. There, on tuning hearts 1001–1006, 341 beats reach 36.9, and the
exponential tail of the largest tenth (above 19.0, mean excess 4.3) puts one beat in 4320 above 45. Shifts by
4 mm put into quiet beats exceed it within 3 beats in 98 %."""
SHIFT_EXPLAINED = 20.0
"""Statistic up to which beats bring a suspended pose back: nine of ten quiet beats with poor images, and more
than 999 of 1000 calm ones, are below."""
SUSPEND_LOG_RATIO, SUSPEND_LOG_RATIO_ALONE = 7.0, 12.0
"""Log-likelihood ratio of a beat's best pose against the pose in use, which two beats in a row or one alone
must exceed to suspend it: the only evidence if LC2's optimum does not reveal where the heart is (surface-only
models). On tuning hearts 1001–1004, calm and with poor images, 1 of 530 beats exceeds 7 (by 1.1), none in a
row; 8 mm off, calm, 95 % of beats exceed 9."""
CONSISTENT_LOG_RATIO = 5.0
"""Log-likelihood ratio up to which a beat confirms a pose: 1 of those 530 beats exceeds it."""
SUSPENDING_REFUSALS = 2
"""Registrations in a row that their own evidence refuses, after which the pose in use is suspended."""
REFUSAL_SIGMA_MM = 1.0
"""Standard error, RMS over the targets, that a refused registration adds to each coordinate of the pose."""
REFUSAL_EVIDENCE = 6.0
"""Reduction of SHIFT_LIMIT by a refused registration: twice the logarithm of 19, for a working registration
refuses 95 % of wrong poses and 5 % of good ones."""
RETRY_S = 4.0
"""Least time between two registrations; one that gave no pose is repeated after it."""
REFRESH_S = 12.0
"""A pose in use is registered again after this time at most."""
RECOVER_S = 3.0
"""A suspended pose is registered again once frames of this long after the disturbance have arrived."""


# ------------------------------------------------------------------ events and actions


@dataclass(frozen=True, slots=True, eq=False)
class Registered:
    """A registration is ready, and its own evidence allows its use, or its renewing a pose in use.

    Attributes:
        now_s: when it is taken.
        registration: its record; estimate: its pose.
        beats: heart beats since the middle of its frames.
        landmarks: mr_from_tracker by touched landmarks, as the change of shape has moved them; None without
            any.
    """

    now_s: float
    registration: RegistrationRecord
    estimate: PoseEstimate
    beats: float
    landmarks: Rigid | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationRefused:
    """A registration is ready, and its own evidence refuses it; `stop` is the reason."""

    now_s: float
    asked_s: float
    stop: Stop


@dataclass(frozen=True, slots=True, eq=False)
class BeatCompared:
    """A heart beat was compared with the pose under test.

    Attributes:
        now_s: when its evaluation is taken.
        evaluation: of that pose.
        again: the beat was compared with an earlier pose before, and counted then.
    """

    now_s: float
    evaluation: BeatEvaluation
    again: bool = False


@dataclass(frozen=True, slots=True)
class BeatMissed:
    """A regular heart beat could not be compared with the pose."""


@dataclass(frozen=True, slots=True, eq=False)
class TipSeen:
    """Images up to `now_s` show the tool's tip."""

    now_s: float
    sighting: TipSighting


@dataclass(frozen=True, slots=True)
class BreathFollowed:
    """From `now_s` on the breath is followed, and frames are those of the heart at rest."""

    now_s: float


PoseEvent = Registered | RegistrationRefused | BeatCompared | BeatMissed | TipSeen | BreathFollowed


@dataclass(frozen=True, slots=True, eq=False)
class RegisterNext:
    """Action: plan the next registration.

    Attributes:
        at_s: when it begins.
        frames_from_s: earlier frames show another pose.
        start: mr_from_tracker to begin at; None leaves it to the plan.
        cancel_running: drop the results of registrations that are being made.
        forget_landmarks: the patient may have moved since landmarks were touched.
    """

    at_s: float
    frames_from_s: float = -inf
    start: Rigid | None = None
    cancel_running: bool = False
    forget_landmarks: bool = False


Action = RegisterNext | PoseUpdate | RegistrationDecision
"""A change of the plan, or an entry of the history."""
Transition = tuple[Pose, tuple[Action, ...]]


# ------------------------------------------------------------------ the transition function


def next_pose(pose: Pose, event: PoseEvent) -> Transition:
    """Return the state after an event, and what is to be done about it."""
    match pose, event:
        case InUse(), Registered():
            return _fuse(pose, event)
        case InUse(), RegistrationRefused():
            return _weaken(pose, event)
        case InUse(), BeatCompared():
            return _follow(pose, event)
        case InUse(), TipSeen():
            return _watch_tip(pose, event)
        case InUse(), BeatMissed():
            return replace(pose, confirmation=pose.confirmation.missed()), ()
        case ((NoPose() | Candidate() | Suspended()), Registered()):
            return _propose(pose, event)
        case ((NoPose() | Candidate() | Suspended()), RegistrationRefused()):
            needs = pose.trial.needs_registration or event.stop is Stop.PHASE_OFFSET
            trial = replace(pose.trial, needs_registration=needs)
            return replace(pose, trial=trial), (retry_after(event.asked_s, event.now_s),)
        case ((Candidate() | Suspended()), BeatCompared()):
            return _test(pose if event.again else _missed(pose), event)
        case ((NoPose() | Candidate() | Suspended()), TipSeen()):
            trial = replace(pose.trial, tip=pose.trial.tip.after(event.sighting))
            return replace(pose, trial=trial), ()
        case ((Candidate() | Suspended()), BeatMissed()):
            return _missed(pose), ()
        case _, BreathFollowed():
            return _restart(pose, event)
    return pose, ()


# ------------------------------------------------------------------ while a pose is in use


def _fuse(pose: InUse, event: Registered) -> Transition:
    """Fuse a registration near the pose in use; elsewhere a usable one suspends it, another weakens it."""
    registration, now_s = event.registration, event.now_s
    off_mm = mean_displacement_mm(event.estimate.pose, pose.estimate.pose, pose.estimate.center_mm)
    if off_mm <= JUMP_MM:
        estimate = pose.estimate.intersected_with(event.estimate, event.beats)
        pose, update = _moved(replace(pose, refusals=0), estimate, now_s)
        return pose, (update, _refresh(registration, now_s))
    if registration.renews:
        return _weaken(pose, RegistrationRefused(now_s, registration.asked_s, Stop.UNBOUNDED))
    doubt = Doubt(DoubtCause.REGISTERED_ELSEWHERE, distance_mm=off_mm)
    before = Suspended(pose.estimate, doubt, pose.confirmation, Trial(pose.shift.restarted(), pose.tip))
    return Candidate(event.estimate, registration, before.trial, before), (
        PoseUpdate(now_s, None, doubt),
        RegistrationDecision(registration, Refused(Refusal.MOVED, off_mm)),
        RegisterNext(now_s + REFRESH_S, forget_landmarks=True),
    )


def _weaken(pose: InUse, event: RegistrationRefused) -> Transition:
    """Make the pose less certain; SUSPENDING_REFUSALS in a row suspend it.

    One is enough if ECG and images disagree: at wrong phases no beat can distinguish a good pose from a wrong
    one.
    """
    asked_s, now_s = event.asked_s, event.now_s
    out_of_phase = event.stop is Stop.PHASE_OFFSET
    if out_of_phase or pose.refusals + 1 >= SUSPENDING_REFUSALS:
        doubt = Doubt(DoubtCause.PHASE_OFFSET if out_of_phase else DoubtCause.REFUSED)
        again = RegisterNext(max(now_s, asked_s + RECOVER_S), frames_from_s=asked_s, forget_landmarks=True)
        return _suspend(pose, doubt, now_s, again, needs_registration=out_of_phase)
    turn = (HEART_RADIUS_MM / TARGET_RADIUS_MM) ** 2
    added_mm2 = REFUSAL_SIGMA_MM**2 * np.diag([turn, turn, turn, 1.0, 1.0, 1.0])
    shared = pose.estimate.shared_mm2 + added_mm2
    estimate = replace(pose.estimate, shared_mm2=shared)
    pose, update = _moved(replace(pose, refusals=pose.refusals + 1), estimate, now_s)
    return pose, (update, retry_after(asked_s, now_s))


def _follow(pose: InUse, event: BeatCompared) -> Transition:
    """Update the pose by a beat that agrees with it; beats that contradict it suspend it.

    A beat without information neither confirms a pose nor moves it.
    """
    beat, measurement, now_s = event.evaluation, event.evaluation.measurement, event.now_s
    estimate, similarity = pose.estimate, pose.similarity
    over = measurement.log_likelihood_ratio > SUSPEND_LOG_RATIO
    pose = replace(pose, contradicting=pose.contradicting + 1 if over else 0)
    if measurement.informative:
        pose = replace(pose, shift=pose.shift.after(beat.begin_s, estimate, measurement))
        similarity = similarity.after(beat.begin_s, beat.view_mm, measurement.best_similarity)
    doubt, changed = _contradiction(pose, beat), False
    if doubt is None and similarity.alarm:
        doubt, changed = Doubt(DoubtCause.CHANGED, similarity.since_s), True
    if doubt is not None:
        again = RegisterNext(
            max(now_s, beat.end_s + RECOVER_S),
            frames_from_s=beat.end_s,
            start=doubt.pose or measurement.best,
            cancel_running=True,
            forget_landmarks=True,
        )
        if not event.again:
            pose = replace(pose, confirmation=pose.confirmation.missed())
        return _suspend(pose, doubt, now_s, again, needs_registration=changed)
    estimate = _updated(estimate, beat) if measurement.informative else estimate.predict(1.0)
    pose, update = _moved(replace(pose, similarity=similarity), estimate, now_s)
    if confirms(measurement):
        pose = replace(pose, confirmation=Confirmation(now_s, estimate.pose_bound_mm))
    elif not event.again:
        pose = replace(pose, confirmation=pose.confirmation.missed())
    return pose, (update,)


def _contradiction(pose: InUse, beat: BeatEvaluation) -> Doubt | None:
    """Return the evidence of the beats up to this one against the pose they were compared with."""
    measurement, shift = beat.measurement, pose.shift.test
    limit = SHIFT_LIMIT - REFUSAL_EVIDENCE * pose.refusals
    if shift is not None and measurement.informative and shift.statistic > limit:
        return Doubt(DoubtCause.SHIFTED, shift.since_s, shift.distance_mm, shift.pose)
    if pose.contradicting > 1 or measurement.log_likelihood_ratio > SUSPEND_LOG_RATIO_ALONE:
        return Doubt(DoubtCause.SHIFTED, beat.begin_s, measurement.moved_mm, measurement.best)
    return None


def _watch_tip(pose: InUse, event: TipSeen) -> Transition:
    """Suspend the pose if the tool is seen elsewhere: calibrations are wrong, and with them every pose."""
    pose = replace(pose, tip=pose.tip.after(event.sighting))
    if pose.tip.off_mm is None:
        return pose, ()
    doubt = Doubt(DoubtCause.TIP_ELSEWHERE, distance_mm=pose.tip.off_mm)
    return _suspend(pose, doubt, event.now_s, RegisterNext(event.now_s + RECOVER_S, cancel_running=True))


def _suspend(
    pose: InUse, doubt: Doubt, now_s: float, again: RegisterNext, *, needs_registration: bool = False
) -> Transition:
    trial = Trial(pose.shift, pose.tip, needs_registration=needs_registration)
    return Suspended(pose.estimate, doubt, pose.confirmation, trial), (PoseUpdate(now_s, None, doubt), again)


def _moved(pose: InUse, estimate: PoseEstimate, now_s: float) -> tuple[InUse, PoseUpdate]:
    """Use another estimate, towards which the pose moves from its present position."""
    here, warp = pose.motion.at(now_s), pose.warp
    motion = PoseMotion.towards(here, estimate.pose, now_s, estimate.center_mm)
    if estimate.warp is not pose.estimate.warp:
        warp = WarpMotion.towards(warp, estimate.warp, now_s)
        if warp is not None:  # walls move by both: together no faster than by one
            warp = replace(warp, end_s=motion.end_s + warp.end_s - now_s)
            motion = PoseMotion.between(here, estimate.pose, now_s, warp.end_s, estimate.center_mm)
    elif estimate.warp is None and warp is not None and warp.end_s <= now_s:
        warp = None  # the heart has its shape again
    confirmation = pose.confirmation.changed(estimate.pose_bound_mm)
    moved = replace(pose, estimate=estimate, motion=motion, warp=warp, confirmation=confirmation)
    return moved, PoseUpdate(now_s, estimate.pose, warp=estimate.warp)


def _restart(pose: Pose, event: BreathFollowed) -> Transition:
    """Register again: what was compared before showed the heart wherever in the breath."""
    again = RegisterNext(event.now_s, cancel_running=True)
    if isinstance(pose, InUse):
        return _suspend(pose, Doubt(DoubtCause.BREATHING), event.now_s, again)
    before, trial = suspended(pose), Trial(tip=pose.trial.tip)
    return NoPose(trial) if before is None else replace(before, trial=trial), (again,)


# ------------------------------------------------------------------ while none is


def _propose(pose: Waiting, event: Registered) -> Transition:
    """Make a registration the candidate, unless the tool or touched landmarks contradict it.

    Landmarks are compared with the first pose only: a patient who moved took them along.
    """
    registration, trial, now_s = event.registration, pose.trial, event.now_s
    retry = retry_after(registration.asked_s, now_s)
    if trial.tip.off_mm is not None:
        refused = Refused(Refusal.TIP_ELSEWHERE, trial.tip.off_mm)
        return pose, (RegistrationDecision(registration, refused), retry)
    before = suspended(pose)
    if before is None and event.landmarks is not None:
        off_mm = mean_displacement_mm(event.estimate.pose, event.landmarks, event.estimate.center_mm)
        if landmarks_disagree(off_mm):
            refused = Refused(Refusal.LANDMARKS_DISAGREE, off_mm)
            pose = replace(pose, trial=replace(trial, needs_registration=False))
            return pose, (RegistrationDecision(registration, refused), retry)
    candidate = Candidate(event.estimate, registration, trial.of_another_pose(), before)
    unconfirmed = RegistrationDecision(registration, Refused(Refusal.UNCONFIRMED))
    return candidate, (unconfirmed, RegisterNext(now_s + REFRESH_S))


def _test(pose: Candidate | Suspended, event: BeatCompared) -> Transition:
    """Count a beat for or against a pose that is not in use."""
    beat, measurement = event.evaluation, event.evaluation.measurement
    if measurement.informative:
        shift = pose.trial.shift.after(beat.begin_s, pose.estimate, measurement, in_use=False)
        pose = replace(pose, trial=replace(pose.trial, shift=shift))
    trial = pose.trial
    if trial.needs_registration or trial.tip.off_mm is not None:
        return pose, ()
    test = trial.shift.test
    statistic = 0.0 if test is None or not measurement.informative else test.statistic
    if isinstance(pose, Candidate) and statistic > SHIFT_LIMIT:
        return _drop(pose, measurement.moved_mm, event.now_s)
    if measurement.log_likelihood_ratio > CONSISTENT_LOG_RATIO:
        if isinstance(pose, Candidate):
            return _drop(pose, measurement.moved_mm, event.now_s)
        return replace(pose, trial=replace(trial, consistent=0)), ()
    if not measurement.informative:
        return pose, ()
    consistent = 0 if statistic > SHIFT_EXPLAINED else trial.consistent + 1
    if consistent < trial.needed:
        return replace(pose, trial=replace(trial, consistent=consistent)), ()
    return _bring_into_use(pose, _updated(pose.estimate, beat), event.now_s)


def _drop(pose: Candidate, off_mm: float, now_s: float) -> Transition:
    """Return to the state before a candidate that a beat contradicts, and ask more of the next."""
    registration, trial = pose.registration, pose.trial.contradicted()
    before = NoPose(trial) if pose.suspended is None else replace(pose.suspended, trial=trial)
    refused = Refused(Refusal.BEAT_DISAGREES, off_mm)
    return before, (RegistrationDecision(registration, refused), retry_after(registration.asked_s, now_s))


def _bring_into_use(pose: Candidate | Suspended, estimate: PoseEstimate, now_s: float) -> Transition:
    """Use a pose that beats have confirmed; at once, for no force depends on one before."""
    motion, confirmation = PoseMotion.still(estimate.pose), Confirmation(now_s, estimate.pose_bound_mm)
    warp = None if estimate.warp is None else WarpMotion.still(estimate.warp)
    in_use = InUse(estimate, motion, warp, confirmation, pose.trial.shift.restarted())
    update = PoseUpdate(now_s, estimate.pose, warp=estimate.warp)
    if isinstance(pose, Suspended):
        return in_use, (update,)
    used = RegistrationDecision(pose.registration, None)
    return in_use, (update, used, _refresh(pose.registration, now_s))


def _missed(pose: Candidate | Suspended) -> Candidate | Suspended:
    """Count a regular beat that did not confirm the last pose in use."""
    before = suspended(pose)
    if before is None:
        return pose
    before = replace(before, confirmation=before.confirmation.missed())
    return replace(pose, suspended=before) if isinstance(pose, Candidate) else before


# ------------------------------------------------------------------ common to all


def confirms(measurement: BeatMeasurement) -> bool:
    """Check whether a beat confirms a pose: it would have contradicted a wrong one, and did not."""
    return measurement.informative and measurement.log_likelihood_ratio <= CONSISTENT_LOG_RATIO


def _updated(estimate: PoseEstimate, beat: BeatEvaluation) -> PoseEstimate:
    measured = beat.measurement
    return estimate.predict(1.0).update(
        measured.offset_information_mm,
        measured.information,
        beat.shape,
        certain=measured.variance_mm2 == 0.0,
    )


def retry_after(asked_s: float, now_s: float) -> RegisterNext:
    """Plan the repetition of a registration that gave no pose."""
    return RegisterNext(max(now_s, asked_s + RETRY_S))


def _refresh(registration: RegistrationRecord, now_s: float) -> RegisterNext:
    """Repeat a registration from little ultrasound as soon as there is twice as much."""
    asked_s = registration.asked_s
    wait_s = min(REFRESH_S, max(RETRY_S, asked_s - registration.from_s))
    return RegisterNext(max(now_s, asked_s + wait_s))
