"""One registration of a recording with what it was made from."""

from dataclasses import dataclass

from dvf_ig.core import Rigid
from dvf_ig.registration import RegistrationResult
from dvf_ig.session import GatedFrames, UltrasoundRecording


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """One registration of a recording's gated frames.

    Attributes:
        result: the pose with its evidence.
        start: mr_from_tracker that it started from.
        landmarks: mr_from_tracker from touched landmarks; None where none were touched.
        frames: which frames were compared with the model, and why others were not.
        recording: they are part of.
    """

    result: RegistrationResult
    start: Rigid
    landmarks: Rigid | None
    frames: GatedFrames
    recording: UltrasoundRecording
