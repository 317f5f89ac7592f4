"""Why a pose that was in use is suspended, and why a usable registration is not used."""

from dataclasses import dataclass
from enum import Enum

from dvf_ig.core import Rigid


class DoubtCause(Enum):
    """Each value is the sentence a user reads, with `{since_s}` and `{mm}` filled in."""

    SHIFTED = "heart beats since {since_s:.1f} s fit {mm:.1f} mm from this pose"
    REGISTERED_ELSEWHERE = "a new registration lies {mm:.1f} mm from this pose"
    REFUSED = "two registrations in a row were refused by their own evidence"
    CHANGED = (
        "since {since_s:.1f} s ultrasound matches the model worse than the same views did before: the "
        "heart may be deformed, or something lies before it"
    )
    TIP_ELSEWHERE = (
        "ultrasound shows the tool {mm:.1f} mm from where its tip should be; calibrate the probe and the "
        "tool's tip again"
    )
    PHASE_OFFSET = "ECG and ultrasound disagree on the phase"


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """One reason to suspend the pose in use.

    Attributes:
        cause: the kind of evidence.
        since_s: begin of the first heart beat that contradicts the pose; 0 if its sentence names none.
        distance_mm: how far the heart seems to have moved, mean over it; 0 if the sentence names none.
        pose: where it seems to lie, mr_from_tracker; None if that is not known.
    """

    cause: DoubtCause
    since_s: float = 0.0
    distance_mm: float = 0.0
    pose: Rigid | None = None

    @property
    def sentence(self) -> str:
        return self.cause.value.format(since_s=self.since_s, mm=self.distance_mm)


class Refusal(Enum):
    """Each value is the sentence a user reads, with the distance `{mm}` filled in."""

    UNCONFIRMED = "waits for heart beats that confirm it"
    LANDMARKS_DISAGREE = (
        "the touched landmarks lie {mm:.1f} mm from where the images put them; check the "
        "probe's calibration, or touch the landmarks again"
    )
    TIP_ELSEWHERE = DoubtCause.TIP_ELSEWHERE.value
    MOVED = "patient or probe moved by {mm:.1f} mm; suspended until heart beats confirm it"
    BEAT_DISAGREES = (
        "ultrasound of a later beat matches best {mm:.1f} mm from this pose; check the probe's "
        "marker and calibration, and that the patient lies still"
    )
    SUSPENDED_MEANWHILE = "a heart beat contradicted the pose in use before this registration was ready"


@dataclass(frozen=True, slots=True)
class Refused:
    """One refusal: its cause, and the distance in mm that its sentence names (0 if it names none)."""

    cause: Refusal
    distance_mm: float = 0.0

    @property
    def sentence(self) -> str:
        return self.cause.value.format(mm=self.distance_mm)
