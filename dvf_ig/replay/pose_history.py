"""Every registration and every evaluated beat of a replay, and the pose that was in use after each."""

from collections.abc import Sequence
from dataclasses import dataclass

from dvf_ig.core import Rigid
from dvf_ig.registration import RegistrationResult

from .beat_evaluation import BeatEvaluation
from .gated_frames import GatedFrames
from .refusal import Refused

PoseUpdates = Sequence[tuple[float, Rigid | None]]
"""(time from which, mr_from_tracker to use) in time order; None where the pose in use was suspended."""


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """One registration.

    Attributes:
        asked_s: when it was started; `ready_s` from when its result could be used.
        frames: the ultrasound it was given.
        result: None where too few frames passed the gate.
        refused: why it is not used though its own evidence would allow it; None where it is.
    """

    asked_s: float
    ready_s: float
    frames: GatedFrames
    result: RegistrationResult | None
    refused: Refused | None = None

    @property
    def usable(self) -> bool:
        return self.result is not None and self.result.stop.usable and self.refused is None

    @property
    def reason(self) -> str:
        """How it ended, as a user reads it."""
        if self.refused is not None:
            return self.refused.sentence
        return self.result.sentence if self.result is not None else self.frames.shortage


@dataclass(frozen=True, slots=True, eq=False)
class PoseHistory:
    """What was known of the heart's pose, in time order.

    Attributes:
        attempts: every registration.
        beats: every beat that was compared with a pose.
        updates: the pose to use from each time on.
    """

    attempts: tuple[Attempt, ...]
    beats: tuple[BeatEvaluation, ...]
    updates: tuple[tuple[float, Rigid | None], ...]
