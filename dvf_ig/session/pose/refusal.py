"""Why a registration is not used although its own evidence would allow it."""

from dataclasses import dataclass
from enum import Enum

from .doubt import DoubtCause


class Refusal(Enum):
    """Each value is the sentence a user reads; `{mm}` stands for the distance that was found."""

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
    """One refusal: its cause, and the distance in mm that its sentence names (0 where it names none)."""

    cause: Refusal
    distance_mm: float = 0.0

    @property
    def sentence(self) -> str:
        return self.cause.value.format(mm=self.distance_mm)
