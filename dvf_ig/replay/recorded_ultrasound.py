"""A recording as the source of ultrasound for the pose tracker: what it is asked for, it computes at once."""

from collections.abc import Callable
from dataclasses import dataclass

from dvf_ig.core import Rigid
from dvf_ig.registration import RegistrationResult, SliceThreads

from .beat_evaluation import BeatSlices, beat_slices
from .frame_registration import register_frames
from .gated_frames import GatedFrames, UltrasoundRecording, gate_recording


@dataclass(frozen=True, slots=True, eq=False)
class RecordedUltrasound:
    """An `UltrasoundSource`.

    Attributes:
        seed: of a registration's random choices.
        clock: times the computing.
        threads: that beats are evaluated on, for as long as they may be asked.
    """

    recording: UltrasoundRecording
    seed: int
    clock: Callable[[], float]
    threads: SliceThreads

    def register(
        self, from_s: float, until_s: float, start: Rigid, *, warm: bool, landmarks: bool
    ) -> tuple[GatedFrames, RegistrationResult | None]:
        """Register the frames in [from_s, until_s) from `start`; no result where they are too few."""
        frames = gate_recording(self.recording, from_s=from_s, until_s=until_s)
        if not frames.enough:
            return frames, None
        result = register_frames(
            self.recording,
            frames,
            start,
            seed=self.seed,
            clock=self.clock,
            warm=warm,
            landmarks=landmarks,
        )
        return frames, result

    def beat(self, last: int) -> BeatSlices | None:
        """The beat that R peak number `last` ended; None where it cannot be compared with the model."""
        return beat_slices(self.recording, last, self.clock, self.threads)
