"""Whether a pose may be used: it must agree with touched landmarks, and with every heart beat since.

A wrong probe calibration, a marker that slipped on the probe and a patient who moved all leave images that
match the model well at some pose. What they do not leave alone is the place: landmarks touched with another
tool disagree at once, the next heart beat matches better at another pose, and after a slip no pose fits the
views of several beats.

    in use ── beats that disagree, a registration elsewhere, or two refused ones ──► suspended: no force
    suspended ── consecutive beats consistent with it, or with a registration made since ──► in use

Beats disagree where the last of them, together, put the heart elsewhere (`ShiftDetector`), or where single
ones fit another pose far better.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from dvf_ig.core import FloatArray, Rigid, Stop, mean_displacement_mm, read_only_arrays
from dvf_ig.registration import (
    BeatMeasurement,
    PoseEstimate,
    ShiftDetector,
    SimilarityWatch,
    TipSighting,
    landmarks_disagree,
)
from dvf_ig.session.refusal import Doubt, DoubtCause, Refusal, Refused
from dvf_ig.session.ultrasound.beat_evaluation import BeatEvaluation

JUMP_MM = 2.5
"""Repeated registrations of an undisturbed patient move by up to 1.2 mm."""
SHIFT_LIMIT = 45.0
"""Statistic of `ShiftDetector` that suspends the pose in use: at most one false alarm in an hour of beats
(4320) even where all images are poor. There, on tuning hearts 1001–1006, 341 beats reach 36.9, and the
exponential tail of the largest tenth (above 19.0, mean excess 4.3) puts one beat in 4320 above 45. Calm, 240
s each, eleven of tuning hearts 1001–1012 stay below 37; one, whose registrations are 1 to 4 mm off, does not.
Shifts by 4 mm put into these beats lie above within 3 beats in 98 %."""
SHIFT_EXPLAINED = 20.0
"""The same up to which beats bring a suspended pose back: quiet beats lie below in nine of ten with poor
images, calm in more than 999 of 1000."""
SUSPEND_LOG_RATIO, SUSPEND_LOG_RATIO_ALONE = 7.0, 12.0
"""Log-likelihood ratio of a beat's best pose against the pose in use, which two beats in a row or one alone
must exceed to suspend it: all there is where LC2's optimum does not tell where the heart is (surface-only
models). On tuning hearts 1001–1004, calm and with poor images, 1 of 530 beats exceeds 7 (by 1.1), none in a
row; 8 mm off, calm, 95 % of beats lie above 9."""
CONSISTENT_LOG_RATIO = 5.0
"""The same up to which a beat confirms a pose: of these beats 1 in 530 lies above."""
CONFIRMING_BEATS, MAX_CONFIRMING_BEATS = 3, 10
"""Consecutive beats that confirm a pose, and twice as many after each registration that beats contradicted: a
patient who moved lies still again, but a slipped marker is wrong in another way from view to view."""
SUSPENDING_REFUSALS = 2
"""Registrations in a row that their own evidence refuses, after which the pose in use is suspended."""
REFUSAL_SIGMA_MM = 1.0
"""Standard deviation per coordinate that one of them adds to the error that the pose in use may have."""
REFUSAL_EVIDENCE = 6.0
"""What one of them takes from SHIFT_LIMIT: twice the logarithm of 19, for a registration that does what it
should refuses 95 % of wrong poses and 5 % of good ones."""
ELSEWHERE_BEATS = 3
"""Sightings of the tool in a row, beside its place, that speak against the calibrations."""


def confirms(measurement: BeatMeasurement) -> bool:
    """Whether a beat says that the pose is right: it would have contradicted a wrong one, and did not."""
    return measurement.informative and measurement.log_likelihood_ratio <= CONSISTENT_LOG_RATIO


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RegistrationMonitor:
    """What the next beat and the next registration are compared with.

    Attributes:
        center_mm: (3,) centre of the heart box, frame "mr".
        landmarks: mr_from_tracker from landmarks touched before the first registration; None without any.
        estimate: the pose in use, or the one that was until it was suspended; None before the first.
        pending: a registration that waits for consistent beats.
        suspended: no force may come from `estimate`.
        consistent_beats: consecutive beats that agree with the pose under test.
        needed_beats: so many of them bring it into use.
        refusals: registrations in a row that were refused by their own evidence while the pose was in use.
        needs_registration: no beat confirms a pose until a registration is usable again: ECG and images
            disagree, or the images have changed as no pose explains.
        shift: the last beats against the pose under test.
        similarity: that of beats since the pose came into use.
        tip_seen: where ultrasound last showed the tool's tip; None before.
        tip_elsewhere: sightings of it in a row that lie beside its place.
        contradicting: beats in a row whose log-likelihood ratio exceeds SUSPEND_LOG_RATIO.
        doubt: why the pose is suspended; None while it is in use, or before the first.
    """

    center_mm: FloatArray
    landmarks: Rigid | None
    estimate: PoseEstimate | None = None
    pending: PoseEstimate | None = None
    suspended: bool = True
    consistent_beats: int = 0
    needed_beats: int = CONFIRMING_BEATS
    refusals: int = 0
    needs_registration: bool = False
    shift: ShiftDetector = field(default_factory=ShiftDetector)
    similarity: SimilarityWatch = field(default_factory=SimilarityWatch.new)
    tip_seen: TipSighting | None = None
    tip_elsewhere: int = 0
    contradicting: int = 0
    doubt: Doubt | None = None

    @property
    def tip_off_mm(self) -> float | None:
        """How far from its place ultrasound shows the tool, so that no pose comes into use; None else."""
        seen = self.tip_seen
        return None if seen is None or self.tip_elsewhere < ELSEWHERE_BEATS else seen.off_mm

    @property
    def under_test(self) -> PoseEstimate | None:
        """The pose that the next beat is compared with."""
        return self.pending or self.estimate

    @property
    def in_use(self) -> PoseEstimate | None:
        """The pose from which force may come."""
        return None if self.suspended else self.estimate

    def after_registration(
        self, found: PoseEstimate, beats: float
    ) -> tuple["RegistrationMonitor", Refused | None]:
        """The next state, and why the registration is not in use yet; its middle is so many beats old."""
        if self.tip_off_mm is not None:
            return self, Refused(Refusal.TIP_ELSEWHERE, self.tip_off_mm)
        if self.suspended or self.estimate is None:
            return replace(self, needs_registration=False)._with_pending(found)
        off_mm = mean_displacement_mm(found.pose, self.estimate.pose, self.center_mm)
        if off_mm <= JUMP_MM:
            updated = self.estimate.intersected_with(found, beats)
            return replace(self, estimate=updated, refusals=0), None
        moved = self._suspended(Doubt(DoubtCause.REGISTERED_ELSEWHERE, distance_mm=off_mm))
        return replace(moved, pending=found, shift=self.shift.restarted()), Refused(Refusal.MOVED, off_mm)

    def after_refusal(self, stop: Stop) -> "RegistrationMonitor":
        """The next state after a registration that its own evidence refused; `stop` says why.

        The first makes the pose in use less certain, SUSPENDING_REFUSALS in a row suspend it. One suffices
        where ECG and images disagree: at wrong phases no beat can tell a good pose from a wrong one.
        """
        if self.suspended or self.estimate is None:
            return replace(self, needs_registration=self.needs_registration or stop is Stop.PHASE_OFFSET)
        if stop is Stop.PHASE_OFFSET:
            return replace(self._suspended(Doubt(DoubtCause.PHASE_OFFSET)), needs_registration=True)
        if self.refusals + 1 >= SUSPENDING_REFUSALS:
            return self._suspended(Doubt(DoubtCause.REFUSED))
        return replace(self, estimate=_less_certain(self.estimate), refusals=self.refusals + 1)

    def after_tip(self, seen: TipSighting) -> "RegistrationMonitor":
        """The next state after images that show the tool's tip.

        Where they show it elsewhere, image calibration, lag or tip is wrong, and every pose with them.
        """
        watched = replace(self, tip_seen=seen, tip_elsewhere=self.tip_elsewhere + 1 if seen.elsewhere else 0)
        off_mm = watched.tip_off_mm
        if off_mm is None or self.in_use is None:
            return watched
        return watched._suspended(Doubt(DoubtCause.TIP_ELSEWHERE, distance_mm=off_mm))

    def _suspended(self, doubt: Doubt) -> "RegistrationMonitor":
        return replace(self, suspended=True, consistent_beats=0, refusals=0, contradicting=0, doubt=doubt)

    def _with_pending(self, found: PoseEstimate) -> tuple["RegistrationMonitor", Refused]:
        """Landmarks are compared with the first pose only: a patient who moved took them along."""
        if self.estimate is None and self.landmarks is not None:
            off_mm = mean_displacement_mm(found.pose, self.landmarks, self.center_mm)
            if landmarks_disagree(off_mm):
                return self, Refused(Refusal.LANDMARKS_DISAGREE, off_mm)
        waiting = replace(self, pending=found, consistent_beats=0, shift=self.shift.restarted())
        return waiting, Refused(Refusal.UNCONFIRMED)

    def after_beat(self, beat: BeatEvaluation) -> "RegistrationMonitor":
        """The next state after a beat that was compared with the pose under test.

        A beat without information neither confirms a pose nor moves it.
        """
        tested, measurement = self.under_test, beat.measurement
        if tested is None:
            return self
        over = measurement.log_likelihood_ratio > SUSPEND_LOG_RATIO
        watched = replace(self, contradicting=self.contradicting + 1 if over else 0)
        if measurement.informative:
            shift = self.shift.after(beat.begin_s, tested, measurement, in_use=not self.suspended)
            watched = replace(watched, shift=shift)
        if self.suspended:
            return watched._retested(tested, measurement)
        doubt = watched._doubt(measurement, beat.begin_s)
        if doubt is not None:
            return watched._suspended(doubt)
        if not measurement.informative:
            return replace(watched, estimate=tested.predict(1.0))
        similarity = self.similarity.after(beat.begin_s, beat.view_mm, measurement.best_similarity)
        if similarity.alarm:
            changed = watched._suspended(Doubt(DoubtCause.CHANGED, similarity.since_s))
            return replace(changed, needs_registration=True)
        return replace(watched, estimate=_updated(tested, measurement), similarity=similarity)

    def _doubt(self, measurement: BeatMeasurement, begin_s: float) -> Doubt | None:
        """What the beats up to the last one, `measurement`, have against the pose they were compared with."""
        shift = self.shift.test
        limit = SHIFT_LIMIT - REFUSAL_EVIDENCE * self.refusals
        if shift is not None and measurement.informative and shift.statistic > limit:
            return Doubt(DoubtCause.SHIFTED, shift.since_s, shift.distance_mm, shift.pose)
        ratio = measurement.log_likelihood_ratio
        if self.contradicting > 1 or ratio > SUSPEND_LOG_RATIO_ALONE:
            return Doubt(DoubtCause.SHIFTED, begin_s, measurement.moved_mm, measurement.best)
        return None

    def _retested(self, tested: PoseEstimate, measurement: BeatMeasurement) -> "RegistrationMonitor":
        """The next state of a suspended pose, or of a registration that waits."""
        if self.needs_registration or self.tip_off_mm is not None:
            return self
        shift = self.shift.test
        statistic = 0.0 if shift is None or not measurement.informative else shift.statistic
        if measurement.log_likelihood_ratio > CONSISTENT_LOG_RATIO or (
            self.pending is not None and statistic > SHIFT_LIMIT
        ):
            return self._contradicted()
        if not measurement.informative:
            return self
        if statistic > SHIFT_EXPLAINED:
            return replace(self, consistent_beats=0)
        if self.consistent_beats + 1 < self.needed_beats:
            return replace(self, consistent_beats=self.consistent_beats + 1)
        return RegistrationMonitor(
            self.center_mm,
            self.landmarks,
            estimate=_updated(tested, measurement),
            suspended=False,
            shift=self.shift.restarted(),
        )

    def _contradicted(self) -> "RegistrationMonitor":
        if self.pending is None:
            return replace(self, consistent_beats=0)
        needed = min(2 * self.needed_beats, MAX_CONFIRMING_BEATS)
        return replace(
            self, pending=None, consistent_beats=0, needed_beats=needed, shift=self.shift.restarted()
        )


def _less_certain(estimate: PoseEstimate) -> PoseEstimate:
    return replace(estimate, shared_mm2=estimate.shared_mm2 + REFUSAL_SIGMA_MM**2 * np.eye(6))


def _updated(tested: PoseEstimate, measurement: BeatMeasurement) -> PoseEstimate:
    return tested.predict(1.0).update(measurement.offset_information_mm, measurement.information)
