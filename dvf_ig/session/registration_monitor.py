"""Whether a pose may be used: it must agree with touched landmarks, and with every heart beat since.

A wrong probe calibration, a marker that slipped on the probe and a patient who moved all leave images that
match the model well at some pose. What they do not leave alone is the place: landmarks touched with another
tool disagree at once, the next heart beat matches better at another pose, and after a slip no pose fits the
views of several beats.

    in use ── a beat that disagrees, or a registration elsewhere ──► suspended: no force
    suspended ── consecutive beats consistent with it, or with a registration made since ──► in use
"""

from dataclasses import dataclass, replace

from dvf_ig.core import FloatArray, Rigid, read_only_arrays
from dvf_ig.registration import BeatMeasurement, PoseEstimate, mean_displacement_mm

from .refusal import Refusal, Refused

LANDMARKS_MM = 4.0
"""Landmark fits of tuning seeds 101–106 lie 0.9 to 1.4 mm from the truth over the heart, good poses 2 mm."""
JUMP_MM = 2.5
"""Repeated registrations of an undisturbed patient move by up to 1.2 mm."""
SUSPEND_LOG_RATIO = 7.0
"""Log-likelihood ratio of a beat's best pose against the pose in use that suspends the latter. On tuning seed
101, calm and with poor images, 170 beats reach 4.4; of beats after a shift of 8 mm, 95 % lie above 9."""
CONSISTENT_LOG_RATIO = 5.0
"""The same up to which a beat confirms a pose: beats of good poses on tuning seeds reach 4.4."""
CONFIRMING_BEATS, MAX_CONFIRMING_BEATS = 3, 10
"""Consecutive beats that confirm a pose, and twice as many after each registration that beats contradicted: a
patient who moved lies still again, but a slipped marker is wrong in another way from view to view."""


def landmark_disagreement_mm(pose: Rigid, landmarks: Rigid | None, center_mm: FloatArray) -> float | None:
    """Distance from the landmark fit that rules out a first pose; None where small, or without a fit."""
    off_mm = 0.0 if landmarks is None else mean_displacement_mm(pose, landmarks, center_mm)
    return off_mm if off_mm > LANDMARKS_MM else None


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
    """

    center_mm: FloatArray
    landmarks: Rigid | None
    estimate: PoseEstimate | None = None
    pending: PoseEstimate | None = None
    suspended: bool = True
    consistent_beats: int = 0
    needed_beats: int = CONFIRMING_BEATS

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
        if self.suspended or self.estimate is None:
            return self._with_pending(found)
        off_mm = mean_displacement_mm(found.pose, self.estimate.pose, self.center_mm)
        if off_mm <= JUMP_MM:
            return replace(self, estimate=self.estimate.update_with(found.predict(beats))), None
        suspended = replace(self, pending=found, suspended=True, consistent_beats=0)
        return suspended, Refused(Refusal.MOVED, off_mm)

    def _with_pending(self, found: PoseEstimate) -> tuple["RegistrationMonitor", Refused]:
        """Landmarks are compared with the first pose only: a patient who moved took them along."""
        off_mm = landmark_disagreement_mm(found.pose, self.landmarks, self.center_mm)
        if self.estimate is None and off_mm is not None:
            return self, Refused(Refusal.LANDMARKS_DISAGREE, off_mm)
        return replace(self, pending=found, consistent_beats=0), Refused(Refusal.UNCONFIRMED)

    def after_beat(self, measurement: BeatMeasurement) -> "RegistrationMonitor":
        """The next state after a beat that was compared with the pose under test."""
        tested = self.under_test
        if tested is None:
            return self
        if not self.suspended:
            if measurement.log_likelihood_ratio > SUSPEND_LOG_RATIO:
                return replace(self, suspended=True, consistent_beats=0)
            return replace(self, estimate=_updated(tested, measurement))
        if measurement.log_likelihood_ratio > CONSISTENT_LOG_RATIO:
            return self._contradicted()
        if self.consistent_beats + 1 < self.needed_beats:
            return replace(self, consistent_beats=self.consistent_beats + 1)
        return RegistrationMonitor(
            self.center_mm, self.landmarks, estimate=_updated(tested, measurement), suspended=False
        )

    def _contradicted(self) -> "RegistrationMonitor":
        if self.pending is None:
            return replace(self, consistent_beats=0)
        needed = min(2 * self.needed_beats, MAX_CONFIRMING_BEATS)
        return replace(self, pending=None, consistent_beats=0, needed_beats=needed)


def _updated(tested: PoseEstimate, measurement: BeatMeasurement) -> PoseEstimate:
    return tested.predict(1.0).update(measurement.offset_information_mm, measurement.information)
