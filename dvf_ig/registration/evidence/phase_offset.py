"""Whether ECG and ultrasound agree on where in the heart's cycle the frames lie.

A clock that is off by a constant puts every frame at a wrong phase, all by the same share of the cycle. The
heart's shape then fits better at phases shifted together, at the pose that was found with the wrong ones:
with S(δ) the similarity when every slice belongs δ of a cycle later,

    ℓ(δ) = n/2·log((1 − S(0)) / (1 − S(δ)))

is the log-likelihood ratio of the shift against none (see `Lc2.information`). The pose need not be found
again for each shift.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Rigid
from dvf_ig.registration.lc2.lc2 import Lc2

SHIFTS = 20
"""As many as a model has phases, as a rule: slices are compared with the volume nearest in the cycle."""
SUSPICIOUS_S = 0.08
"""A phase offset beyond this is suspicious if its log-likelihood ratio exceeds SUSPICIOUS_LOG_RATIO."""
SUSPICIOUS_LOG_RATIO = 2.0
"""In 33 undisturbed registrations of tuning seeds 101 to 104 (calm, ectopy, poor images, both motions) the
best shift is within 0.05 of the cycle, its ratio at most 0.6. An ECG 300 ms late gives 9.2 to 38 with good
images, with poor ones 8.8 to 14 (physiological motion) and 1.5 to 5.2 (5 mm; 8 of 9 above 2.0)."""


@dataclass(frozen=True, slots=True)
class PhaseOffset:
    """How much later in the cycle the images fit than the ECG says.

    Attributes:
        shift: best common shift of the slices, in [−0.5, 0.5) of the cycle.
        offset_s: the same in s; positive where the ECG's times are late.
        log_likelihood_ratio: of that shift against none, >= 0.
    """

    shift: float
    offset_s: float
    log_likelihood_ratio: float

    @property
    def suspicious(self) -> bool:
        """Whether the ECG contradicts the images."""
        return abs(self.offset_s) > SUSPICIOUS_S and self.log_likelihood_ratio > SUSPICIOUS_LOG_RATIO

    @property
    def sentence(self) -> str:
        """The sentence a user reads if it is suspicious."""
        which = "late" if self.offset_s > 0 else "early"
        return (
            f"ECG and ultrasound disagree: the ECG is {1e3 * abs(self.offset_s):.0f} ms {which}; it is of "
            "another recording, or its clock or the latency is off"
        )


def phase_offset(metric: Lc2, pose: Rigid, rr_s: float) -> PhaseOffset:
    """The common shift of the slices' phases that the images fit best.

    Args:
        metric: LC2 of the registered slices, of many beats and views; coarse ones do.
        pose: target_from_source that was found with their phases as given.
        rr_s: usual length of their beats.
    """
    left = np.array([1.0 - metric.similarity_at_shift(pose, k / SHIFTS) for k in range(SHIFTS)])
    left = np.maximum(left, 1e-12)
    ratios = 0.5 * metric.information * np.log(left[0] / left)
    return offset_of(ratios, rr_s)


def offset_of(log_ratios: FloatArray, rr_s: float) -> PhaseOffset:
    """The best shift and its ratio, by a parabola through the best of (SHIFTS,) equidistant ones.

    The log-likelihood ratios of several independent registrations add; so may their curves.
    """
    best = int(np.argmax(log_ratios))
    before, here, after = (float(log_ratios[(best + k) % len(log_ratios)]) for k in (-1, 0, 1))
    bend = before - 2.0 * here + after
    part = 0.5 * (before - after) / bend if bend < 0 else 0.0
    shift = ((best + part) / len(log_ratios) + 0.5) % 1.0 - 0.5
    ratio = max(here - 0.25 * (before - after) * part, 0.0)
    return PhaseOffset(shift, shift * rr_s, ratio)
