"""A registered pose with its evidence."""

from dataclasses import dataclass, replace

from dvf_ig.core import FloatArray, Rigid, Stop, read_only_arrays
from dvf_ig.core.summary import Rows, summary_html, summary_text
from dvf_ig.registration.evidence.assessment import ImageStatistics
from dvf_ig.registration.evidence.checks import Evidence
from dvf_ig.registration.shape.change import ANOTHER_HEART_MM, ShapeChange
from dvf_ig.registration.surface_points.touched import SurfaceDisagreement

from .coverage import Coverage
from .images import RegistrationOptions
from .start import LANDMARKS_MM, landmarks_disagree

LONG_AXIS = "the long-axis cines of the same examination (preop.views), or "
"""What bounds the pose of a heart of which the MR holds short-axis slices alone."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RegistrationResult:
    """A pose with its evidence. `stop.usable` says whether it may guide.

    Attributes:
        target_from_source: the pose; the frames are in the value.
        start: target_from_source that it began at.
        stop: how it ended.
        success_probability: chance that the mean error over the heart, or over its covered part, is below
            2 mm (see `evidence.assessment`); None where `outside` says why none can be
            stated, or it was refused.
        tre_bound_mm: in 95 of 100 hearts the largest error over the targets of the heart box, or over the
            surface of the covered part of a heart that its images cover in part, is below this; None if that
            cannot be stated, or a check refused the pose.
        covariance: (6, 6) rad², mm²; rotation vector then translation, left perturbation about `center_mm`.
        noise_covariance: (6, 6) likewise, of what independent patches would leave open: the part that
            later heart beats, of the same calibrations and anatomy, can reduce.
        center_mm: (3,) centre of the heart box in the target frame.
        evidence: what the pose was tested by.
        statistics: of the slices, and how they lie to the model; None for a pair of organs.
        outside: why neither probability nor bound can be stated; empty where they are.
        similarity, start_similarity: LC2 at the result and at the start pose.
        overlap: share of the slices inside the model's volume; of a heart that its images cover in part,
            share of that part that the slices image.
        second_best: LC2 of the best candidate more than 4 mm away; 0 if there was none.
        moved_mm: mean distance over the heart between start and result.
        evaluations: of LC2's normal equations; slices: effort.
        seconds: computing time by the caller's clock, the preparation of the images included.
        options: what it was searched with, and the limits of its evidence.
        covariance_scale: by which the covariance was multiplied, see `evidence.assessment`.
        matched: where the images match best, were the heart's shape that of the model; None: at the pose.
        landmarks_mm: mean distance over the heart from the pose of touched landmarks; None without any.
        touched: how far points touched on the heart's surface lie from it at the pose; None without any.
        coverage: how much of a heart that its images cover in part the slices image; None for a whole one.
        shape: how the heart has changed its shape; None if no change was found, or nothing shows it.
    """

    target_from_source: Rigid
    start: Rigid
    stop: Stop
    success_probability: float | None
    tre_bound_mm: float | None
    covariance: FloatArray
    noise_covariance: FloatArray
    center_mm: FloatArray
    evidence: Evidence
    statistics: ImageStatistics | None
    outside: str
    similarity: float
    start_similarity: float
    overlap: float
    second_best: float
    moved_mm: float
    evaluations: int
    seconds: float
    slices: int
    options: RegistrationOptions
    covariance_scale: float = 1.0
    matched: Rigid | None = None
    landmarks_mm: float | None = None
    touched: SurfaceDisagreement | None = None
    coverage: Coverage | None = None
    shape: ShapeChange | None = None

    def __repr__(self) -> str:
        return summary_text("RegistrationResult", self._rows)

    def _repr_html_(self) -> str:
        return summary_html("RegistrationResult", self._rows)

    @property
    def _rows(self) -> Rows:
        chance, bound = self.success_probability, self.tre_bound_mm
        return [
            ("pose", self.target_from_source.name),
            ("outcome", f"{self.stop.name}, {'may' if self.stop.usable else 'must not'} be used"),
            ("success probability", "not stated" if chance is None else f"{chance:.2f}"),
            (
                "largest error over the heart",
                "not stated" if bound is None else f"below {bound:.1f} mm (95 %)",
            ),
            ("similarity", f"{self.start_similarity:.3f} at the start, {self.similarity:.3f} registered"),
            ("moved", f"{self.moved_mm:.1f} mm"),
        ]

    def refused(self, stop: Stop) -> "RegistrationResult":
        """Refuse the pose by evidence from outside of the images, such as touched landmarks."""
        return replace(self, stop=stop, success_probability=None, tre_bound_mm=None)

    @property
    def sentence(self) -> str:
        """How it ended, as a user reads it."""
        if self.stop is Stop.PHASE_OFFSET and self.evidence.phase_offset is not None:
            return self.evidence.phase_offset.sentence
        offset = self.evidence.image_offset
        if self.stop is Stop.DISAGREEMENT and offset is not None and offset.suspicious:
            return offset.sentence
        pair, landmarks_mm = self.evidence.pair, self.landmarks_mm
        images_agree = self.evidence.worst_test_ratio(self.options.limits) <= 1.0
        if self.stop is Stop.DISAGREEMENT and images_agree and landmarks_disagree(landmarks_mm):
            return (
                f"the images agree among themselves, and put the heart {landmarks_mm:.1f} mm from where the "
                f"touched landmarks do (at most {LANDMARKS_MM:g}); do not guide by it. Check in this order: "
                "probe calibration (of another day or probe, or its marker moved), the tool's tip, landmarks"
            )
        if self.stop is Stop.CHANGED_SHAPE and self.shape is not None:
            sentence = f"{self.shape.sentence}; {self.shape.refusal}"
            if self.shape.seen_mm > ANOTHER_HEART_MM:
                sentence += "; the model may be another patient's"
            if landmarks_disagree(landmarks_mm):
                sentence += (
                    f". Touched landmarks lie {landmarks_mm:.1f} mm off: check the probe calibration first"
                )
            return sentence
        if self.stop is Stop.LOW_OVERLAP and self.coverage is not None:
            return self.coverage.advice
        if self.stop in (Stop.DOUBTFUL, Stop.UNBOUNDED) and self.coverage is not None:
            instead = f"or give {'' if self.coverage.views else LONG_AXIS}MR of the whole heart"
            why = f"the MR ends within the heart, and {self._why_doubtful}"
            return f"{why}; {self.coverage.advice}, {instead}"
        if self.stop is Stop.LOW_OVERLAP and pair is None:
            return f"{self.stop.value}, and check that its poses are the probe's and not the tool's"
        if pair is not None and self.stop in (Stop.DISAGREEMENT, Stop.AMBIGUOUS):
            return pair.sentence
        return str(self.stop.value)

    @property
    def _why_doubtful(self) -> str:
        """Why the pose of a heart that its images cover in part is refused though it passed each check."""
        if self.tre_bound_mm is not None:
            return f"the checks bound the error over its covered part to {self.tre_bound_mm:.1f} mm only"
        return self.outside or "the checks together are worse than those of nearly all good poses"
