"""A registered pose with its evidence."""

from dataclasses import dataclass

from dvf_ig.core import FloatArray, Rigid, Stop, read_only_arrays
from dvf_ig.registration.evidence.checks import Evidence

from .data import RegistrationOptions


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RegistrationResult:
    """A pose with its evidence. `stop.usable` says whether it may guide.

    Attributes:
        target_from_source: the pose; the frames are in the value.
        stop: how it ended.
        success_probability: chance that the mean error over the heart is below 2 mm (see `evidence.checks`).
        covariance: (6, 6) rad², mm²; rotation vector then translation, left perturbation about `center_mm`.
        center_mm: (3,) centre of the heart box in the target frame.
        evidence: what the pose was tested by.
        similarity, start_similarity: LC2 at the result and at the start pose.
        overlap: share of the slices inside the model's volume.
        second_best: LC2 of the best candidate more than 4 mm away; 0 if there was none.
        moved_mm: mean distance over the heart between start and result.
        evaluations: of LC2's normal equations; seconds: by the caller's clock; slices: effort.
        options: what it was searched with, and the limits that its evidence was held against.
    """

    target_from_source: Rigid
    stop: Stop
    success_probability: float
    covariance: FloatArray
    center_mm: FloatArray
    evidence: Evidence
    similarity: float
    start_similarity: float
    overlap: float
    second_best: float
    moved_mm: float
    evaluations: int
    seconds: float
    slices: int
    options: RegistrationOptions

    @property
    def sentence(self) -> str:
        """How it ended, as a user reads it."""
        if self.stop is Stop.PHASE_OFFSET and self.evidence.phase_offset is not None:
            return self.evidence.phase_offset.sentence
        pair = self.evidence.pair
        if pair is not None and self.stop in (Stop.DISAGREEMENT, Stop.AMBIGUOUS):
            return pair.sentence
        return self.stop.value
