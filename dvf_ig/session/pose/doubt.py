"""Why a pose that was in use is suspended."""

from dataclasses import dataclass
from enum import Enum

from dvf_ig.core import Rigid


class DoubtCause(Enum):
    """Each value is the sentence a user reads; `{since_s}` and `{mm}` stand for what was found."""

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
    """One doubt.

    Attributes:
        cause: what it rests on.
        since_s: begin of the first heart beat that speaks for it; 0 where its sentence names none.
        distance_mm: how far the heart seems to have moved, mean over it; 0 where the sentence names none.
        pose: where it seems to lie, mr_from_tracker; None where that is not known.
    """

    cause: DoubtCause
    since_s: float = 0.0
    distance_mm: float = 0.0
    pose: Rigid | None = None

    @property
    def sentence(self) -> str:
        return self.cause.value.format(since_s=self.since_s, mm=self.distance_mm)
