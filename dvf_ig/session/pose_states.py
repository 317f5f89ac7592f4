"""The four states of the heart's pose, as frozen values.

    NoPose      no registration has been confirmed yet
    Candidate   a registration that waits for heart beats to confirm it
    InUse       a pose that forces depend on; every beat confirms, moves or contradicts it
    Suspended   a pose that was in use: no force until beats confirm it, or a newer one

`pose_transition` has what leads from one to the next. Beats also age a pose: one that none has confirmed for
long is withheld (`Confirmation`; docs/theory/safety.md, trust).
"""

from dataclasses import dataclass, field, replace
from math import inf

from dvf_ig.core import FloatArray, PoseMotion, WarpMotion
from dvf_ig.registration import PoseEstimate, ShiftDetector, SimilarityWatch, TipSighting

from .reasons import Doubt
from .ultrasound_registration import RegistrationRecord

CONFIRMING_BEATS, MAX_CONFIRMING_BEATS = 3, 10
"""Consecutive beats that confirm a pose, and twice as many after each registration that beats contradicted: a
patient who moved is at rest again, but a slipped marker is wrong in another way from view to view."""
ELSEWHERE_BEATS = 3
"""Sightings of the tool in a row, away from where its tip should be, that contradict the calibrations."""
MAX_MISSED_BEATS, MAX_AGE_S = 3, 5.0
"""Regular beats in a row, and time, without a confirmation, after which a pose is withheld."""
MAX_BOUND_MM = 5.0
"""95 % bound on the error of a pose that is withheld: a force on a pose further off is a hazard."""
AGEING_MM_PER_S = 10.0 / 60.0
"""Growth of that bound while no beat confirms the pose: a patient's creep by 10 mm a minute."""


# ------------------------------------------------------------------ parts of states


@dataclass(frozen=True, slots=True)
class Confirmation:
    """The last heart beat that confirmed the pose in use.

    Attributes:
        confirmed_s: when that was known.
        pose_bound_mm: 95 % bound on the RMS error then, see `PoseEstimate`.
        missed_beats: regular beats since that could not be compared with the pose, carried no information, or
            did not agree with it.
    """

    confirmed_s: float
    pose_bound_mm: float
    missed_beats: int = 0

    @property
    def until_s(self) -> float:
        """Time from which the pose is withheld unless a beat confirms it; -inf if it already is."""
        lasts_s = min(MAX_AGE_S, (MAX_BOUND_MM - self.pose_bound_mm) / AGEING_MM_PER_S)
        if self.missed_beats >= MAX_MISSED_BEATS or lasts_s <= 0.0:
            return -inf
        return self.confirmed_s + lasts_s

    def bound_mm(self, now_s: float) -> float:
        """95 % bound on the error of the pose at `now_s`."""
        return self.pose_bound_mm + AGEING_MM_PER_S * (now_s - self.confirmed_s)

    def missed(self) -> "Confirmation":
        """Count a regular beat that did not confirm the pose."""
        return replace(self, missed_beats=self.missed_beats + 1)

    def changed(self, pose_bound_mm: float) -> "Confirmation":
        """State another bound, after a change of the pose without a beat that confirms it."""
        return replace(self, pose_bound_mm=pose_bound_mm)


@dataclass(frozen=True, slots=True)
class TipEvidence:
    """Sightings of the tool in ultrasound, as evidence about the calibrations.

    Attributes:
        last_mm: distance of the last sighting from where the tip should be.
        elsewhere: sightings in a row that are too far from there.
    """

    last_mm: float = 0.0
    elsewhere: int = 0

    def after(self, seen: TipSighting) -> "TipEvidence":
        """Count one more sighting."""
        return TipEvidence(seen.off_mm, self.elsewhere + 1 if seen.elsewhere else 0)

    @property
    def off_mm(self) -> float | None:
        """Error of the calibrations, which keeps every pose from use; None without enough evidence."""
        return self.last_mm if self.elsewhere >= ELSEWHERE_BEATS else None


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """Heart beats against a pose that is not in use.

    Attributes:
        shift: the last beats against the pose.
        tip: sightings of the tool.
        consistent: consecutive beats that agree with the pose; `needed` of them bring it into use.
        needs_registration: beats confirm nothing until a registration is usable again: ECG and images
            disagree, or the images have changed as no pose explains.
    """

    shift: ShiftDetector = field(default_factory=ShiftDetector)
    tip: TipEvidence = TipEvidence()
    consistent: int = 0
    needed: int = CONFIRMING_BEATS
    needs_registration: bool = False

    def of_another_pose(self) -> "Trial":
        """Begin again with a new registration."""
        return replace(self, shift=self.shift.restarted(), consistent=0, needs_registration=False)

    def contradicted(self) -> "Trial":
        """Begin again with the pose before, and ask twice as many beats of the next registration."""
        needed = min(2 * self.needed, MAX_CONFIRMING_BEATS)
        return replace(self, shift=self.shift.restarted(), consistent=0, needed=needed)


# ------------------------------------------------------------------ states


@dataclass(frozen=True, slots=True, eq=False)
class NoPose:
    """No registration has been confirmed yet, and none waits for it."""

    trial: Trial = field(default_factory=Trial)


@dataclass(frozen=True, slots=True, eq=False)
class InUse:
    """A pose that forces depend on.

    Attributes:
        estimate: the pose with its covariance.
        motion: the pose over time, which moves to `estimate` at a bounded speed; warp: likewise the change of
            the heart's shape, None of one that has kept it.
        confirmation: the last beat that confirmed it.
        shift: the last beats against the pose.
        similarity: of the beats since the pose came into use.
        tip: sightings of the tool.
        contradicting: beats in a row whose log-likelihood ratio exceeds SUSPEND_LOG_RATIO.
        refusals: registrations in a row that their own evidence refused.
    """

    estimate: PoseEstimate
    motion: PoseMotion
    warp: WarpMotion | None
    confirmation: Confirmation
    shift: ShiftDetector = field(default_factory=ShiftDetector)
    similarity: SimilarityWatch = field(default_factory=SimilarityWatch.new)
    tip: TipEvidence = TipEvidence()
    contradicting: int = 0
    refusals: int = 0

    def covariance_mm2(self, now_s: float) -> FloatArray:
        """(6, 6) of the pose, less what the variance of a warp that is reached holds: the registration's."""
        of_warp = self.estimate.warp is not None and self.warp is not None and self.warp.end_s <= now_s
        return self.estimate.covariance_mm2 if of_warp else self.estimate.total_mm2


@dataclass(frozen=True, slots=True, eq=False)
class Suspended:
    """A pose that was in use; no force may come from it until beats confirm it or a newer one.

    Attributes:
        estimate: that pose with its covariance, as it was.
        doubt: the evidence against it.
        confirmation: the last beat that confirmed it.
        trial: beats since.
    """

    estimate: PoseEstimate
    doubt: Doubt
    confirmation: Confirmation
    trial: Trial


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A registration that waits for consistent beats.

    Attributes:
        estimate: its pose with its covariance.
        registration: its record.
        trial: beats against it.
        suspended: the pose in use before; None before the first.
    """

    estimate: PoseEstimate
    registration: RegistrationRecord
    trial: Trial
    suspended: Suspended | None


Pose = NoPose | Candidate | InUse | Suspended
Waiting = NoPose | Candidate | Suspended
"""States without a force."""


def under_test(pose: Pose) -> PoseEstimate | None:
    """Return the pose that the next beat is compared with."""
    return None if isinstance(pose, NoPose) else pose.estimate


def suspended(pose: Pose) -> Suspended | None:
    """Return the suspended pose, also while a candidate is tested; None while one is in use or none was."""
    if isinstance(pose, Candidate):
        return pose.suspended
    return pose if isinstance(pose, Suspended) else None


def last_used(pose: Pose) -> InUse | Suspended | None:
    """Return the pose in use, or the one that was until it was suspended; None before the first."""
    return pose if isinstance(pose, InUse) else suspended(pose)
