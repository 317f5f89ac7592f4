"""Append-only log of a session: R peaks, registrations and decisions about them, beats, pose updates."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

from dvf_ig.cardiac import RPeak
from dvf_ig.core import Rigid, Warp
from dvf_ig.registration import TipSighting

from .beat_evaluation import BeatEvaluation
from .breathing import BreathingRecord
from .reasons import Doubt, Refused
from .ultrasound_registration import RegistrationRecord


@dataclass(frozen=True, slots=True, eq=False)
class PoseUpdate:
    """A change of the pose in use.

    Attributes:
        from_s: when it took effect.
        pose: mr_from_tracker from then on; None if the pose in use was suspended.
        doubt: why it was suspended; None if it was not.
        warp: change of the heart's shape at the pose; None if it has kept its shape.
    """

    from_s: float
    pose: Rigid | None
    doubt: Doubt | None = None
    warp: Warp | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationDecision:
    """A decision about a registration; a later one about the same registration replaces it.

    Attributes:
        registration: its record.
        refused: why its pose is not used; None if it is.
    """

    registration: RegistrationRecord
    refused: Refused | None


Entry = (
    RPeak
    | RegistrationRecord
    | RegistrationDecision
    | BeatEvaluation
    | PoseUpdate
    | TipSighting
    | BreathingRecord
)


class SessionHistory:
    """The entries of each kind in time order; a bounded history forgets the oldest of a kind."""

    def __init__(self, longest: int | None = None) -> None:
        self._peaks: deque[RPeak] = deque(maxlen=longest)
        self._registrations: deque[RegistrationRecord] = deque(maxlen=longest)
        self._decisions: deque[RegistrationDecision] = deque(maxlen=longest)
        self._beats: deque[BeatEvaluation] = deque(maxlen=longest)
        self._updates: deque[PoseUpdate] = deque(maxlen=longest)
        self._sightings: deque[TipSighting] = deque(maxlen=longest)
        self._breathing: deque[BreathingRecord] = deque(maxlen=longest)
        self.last_registration: RegistrationRecord | None = None
        """The newest of `registrations`; None without any."""

    def append(self, entry: Entry) -> None:
        """Add the newest entry of its kind."""
        match entry:
            case RPeak():
                self._peaks.append(entry)
            case RegistrationRecord():
                self._registrations.append(entry)
                self.last_registration = entry
            case RegistrationDecision():
                self._decisions.append(entry)
                if self._registrations and entry.registration is self._registrations[-1]:
                    self.last_registration = replace(entry.registration, refused=entry.refused)
            case BeatEvaluation():
                self._beats.append(entry)
            case PoseUpdate():
                self._updates.append(entry)
            case TipSighting():
                self._sightings.append(entry)
            case BreathingRecord():
                self._breathing.append(entry)

    @property
    def peaks(self) -> Sequence[RPeak]:
        """R peaks, in order of their detection."""
        return self._peaks

    @property
    def beats(self) -> Sequence[BeatEvaluation]:
        """Beats that were compared with a pose."""
        return self._beats

    @property
    def updates(self) -> Sequence[PoseUpdate]:
        """Poses to use from each time on."""
        return self._updates

    @property
    def sightings(self) -> Sequence[TipSighting]:
        """Sightings of the tool's tip, one for each beat whose images show it."""
        return self._sightings

    @property
    def breathing(self) -> Sequence[BreathingRecord]:
        """What was found about the motion in breathing."""
        return self._breathing

    @property
    def registrations(self) -> tuple[RegistrationRecord, ...]:
        """Registrations that ended, each with the last decision about it."""
        return tuple(self._decided(record) for record in self._registrations)

    def _decided(self, record: RegistrationRecord) -> RegistrationRecord:
        for decision in reversed(self._decisions):
            if decision.registration is record:
                return replace(record, refused=decision.refused)
        return record
