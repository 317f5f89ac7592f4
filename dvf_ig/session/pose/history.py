"""What happened in a session: R peaks, registrations, evaluated beats, and the pose in use after each."""

from collections import deque
from dataclasses import dataclass, replace

from dvf_ig.cardiac import RPeak
from dvf_ig.core import Rigid
from dvf_ig.registration import TipSighting
from dvf_ig.session.refusal import Doubt, Refused
from dvf_ig.session.ultrasound.beat_evaluation import BeatEvaluation
from dvf_ig.session.ultrasound.frame_registration import RegistrationRecord


@dataclass(frozen=True, slots=True, eq=False)
class PoseUpdate:
    """A change of the pose in use.

    Attributes:
        from_s: when it took effect.
        pose: mr_from_tracker from then on; None where the pose in use was suspended.
        doubt: why it was suspended; None where it was not.
    """

    from_s: float
    pose: Rigid | None
    doubt: Doubt | None = None


class SessionHistory:
    """In time order; a bounded one forgets the oldest.

    Attributes:
        peaks: R peaks.
        attempts: registrations.
        beats: beats that were compared with a pose.
        updates: the pose to use from each time on.
        sightings: of the tool's tip in the images, after each beat in which it was seen.
    """

    def __init__(self, longest: int | None = None) -> None:
        self.peaks: deque[RPeak] = deque(maxlen=longest)
        self.attempts: deque[RegistrationRecord] = deque(maxlen=longest)
        self.beats: deque[BeatEvaluation] = deque(maxlen=longest)
        self.updates: deque[PoseUpdate] = deque(maxlen=longest)
        self.sightings: deque[TipSighting] = deque(maxlen=longest)

    def set_refused(self, asked_s: float, refused: Refused | None) -> None:
        """Change why the registration that was asked for at `asked_s` is not used."""
        for i, attempt in enumerate(self.attempts):
            if attempt.asked_s == asked_s:
                self.attempts[i] = replace(attempt, refused=refused)
