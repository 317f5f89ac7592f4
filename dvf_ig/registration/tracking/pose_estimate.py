"""Pose tracking between registrations: one measurement from each heart beat, fused by an information filter.

Each finished heart beat gives a handful of slices from nearly one view. Their LC2 is optimised from the pose
in use under a wide Gaussian prior (PRIOR_SIGMA_MM), which gives, in the coordinates of `PoseChart` about that
pose,

    ξ, J    optimum of the beat's slices, and its information              curvature of the cost
    ℓ       log-likelihood ratio of that optimum against the pose in use   −n/2·log(1 − S)

Monitoring: ℓ beyond what noise explains contradicts the pose. A beat that does not contradict it confirms it
only if it would have contradicted a wrong one; so the optimum is compared with poses WRONG_MM from it.
Tracking: an information filter,
    predict  P ← P + Q
    update   Λ = P⁻¹ + J,   ξ̂ = Λ⁻¹ (J ξ),   P ← Λ⁻¹,
so that directions which one beat cannot observe keep what earlier beats knew of them.
"""

import math
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Rigid, mean_displacement_mm, read_only_arrays
from dvf_ig.registration.lc2.lc2 import Lc2
from dvf_ig.registration.lc2.optimise import OptimiserOptions, optimise
from dvf_ig.registration.pose_chart import PoseChart, covariance_to_mm

PRIOR_SIGMA_MM = 6.0
"""Standard deviation per coordinate of the prior about the pose in use: bounds what a beat cannot observe."""
FIXED_FIT_STIFFNESS = 4.0
"""Curvature with the local fits fixed over what a beat's errors show: on tuning seeds 101–104 their χ² of 6
degrees has a median of 4.9 to 7.5. With the 8 to 12 of true curvature (see `lc2.optimise`) a still pose is
better, 0.87 against 0.92 mm, but its stated uncertainty is twice too large and a drift is followed too
slowly."""
PROCESS_NOISE_MM = 0.15
"""Standard deviation per coordinate of the heart's displacement from beat to beat. With a FIXED_FIT_STIFFNESS
of 10, 0.15 or 0.2 gives tuning seeds 101 and 103 0.84 or 0.87 mm still, and 101, drifting by 10 mm/min, 1.36
or 1.28."""
WRONG_MM = 8.0
"""How far the wrong poses lie that a beat's optimum is compared with: a patient's shift worth finding."""
WRONG_DIRECTIONS = np.diag([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])[3:]
"""(3, 6) translations along the axes; more of them, or rotations, tell no more and cost 3 ms each."""
INFORMATIVE_LOG_RATIO = 1.5
"""Mean log-likelihood ratio of a beat's optimum against wrong poses, from which on it can confirm a pose. On
tuning seeds 101 to 103 good poses have 3.1 or more with poor images, 8 with few slices, 15 calm; black images
have 0, noise and speckle of any grain up to 0.44."""
BEAT_OPTIMISER = OptimiserOptions(steps=10, cap_mm=5.0, tolerance_mm=0.1)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """A pose and how well it is known.

    Attributes:
        pose: target_from_source.
        covariance_mm2: (6, 6) in the coordinates of `PoseChart` about `center_mm`.
        center_mm: (3,) centre of the heart box, target frame.
    """

    pose: Rigid
    covariance_mm2: FloatArray
    center_mm: FloatArray

    @classmethod
    def from_registration(cls, pose: Rigid, covariance: FloatArray, center_mm: FloatArray) -> "PoseEstimate":
        """From a registration's covariance in rad², mm²."""
        return cls(pose, covariance_to_mm(covariance), center_mm)

    def predict(self, beats: float) -> "PoseEstimate":
        """The same pose after so many beats, with the process noise of each."""
        return PoseEstimate(
            self.pose, self.covariance_mm2 + beats * PROCESS_NOISE_MM**2 * np.eye(6), self.center_mm
        )

    def update(self, offset_information_mm: FloatArray, information: FloatArray) -> "PoseEstimate":
        """The estimate with one more measurement.

        Args:
            offset_information_mm: (6,) Jξ, per mm, with ξ in the coordinates of `PoseChart` about `pose`.
            information: (6, 6) J, per mm².
        """
        covariance = np.asarray(np.linalg.inv(np.linalg.inv(self.covariance_mm2) + information))
        offset = covariance @ offset_information_mm
        return PoseEstimate(PoseChart(self.pose, self.center_mm).pose(offset), covariance, self.center_mm)

    def update_with(self, other: "PoseEstimate") -> "PoseEstimate":
        """Both estimates weighted by their inverse covariances, taken as independent."""
        information = np.asarray(np.linalg.inv(other.covariance_mm2))
        offset = PoseChart(self.pose, self.center_mm).coordinates(other.pose)
        return self.update(information @ offset, information)

    def sigma_mm(self) -> float:
        """Standard deviation per coordinate, RMS over the six."""
        return float(np.sqrt(np.trace(self.covariance_mm2) / 6.0))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BeatMeasurement:
    """The slices of one beat, evaluated at a pose.

    Attributes:
        pose: at which they were evaluated; `best`: their optimum from there.
        offset_information_mm, information: (6,) Jξ and (6, 6) J in coordinates of `PoseChart` about `pose`; J
            is singular in directions that the slices do not observe.
        similarity: LC2 at `pose`; `best_similarity` at `best`.
        log_likelihood_ratio: of `best` against `pose`, >= 0.
        wrong_pose_log_ratio: of `best` against poses WRONG_MM from it, mean: what the beat would say of them.
        moved_mm: mean distance over the heart between `pose` and `best`.
        overlap: share of the slices inside the model's volume.
        evaluations: effort.
    """

    pose: Rigid
    best: Rigid
    offset_information_mm: FloatArray
    information: FloatArray
    similarity: float
    best_similarity: float
    log_likelihood_ratio: float
    wrong_pose_log_ratio: float
    moved_mm: float
    overlap: float
    evaluations: int

    @property
    def informative(self) -> bool:
        """Whether the beat says anything of the pose: black images, noise and mere speckle do not."""
        return self.wrong_pose_log_ratio >= INFORMATIVE_LOG_RATIO


@dataclass(frozen=True, slots=True, eq=False)
class _GaussianPrior:
    """A pose with a standard deviation of PRIOR_SIGMA_MM in every coordinate, as a prior of `optimise`."""

    chart: PoseChart

    def energy(self, pose: Rigid) -> float:
        xi = self.chart.coordinates(pose)
        return float(0.5 * (xi @ xi) / PRIOR_SIGMA_MM**2)

    def normal_equations(self, pose: Rigid, center_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Small turns add: the Jacobian of ξ is taken as the identity, and the centre as the chart's."""
        return np.eye(6) / PRIOR_SIGMA_MM**2, -self.chart.coordinates(pose) / PRIOR_SIGMA_MM**2


def measure_beat(metric: Lc2, pose: Rigid, center_mm: FloatArray) -> BeatMeasurement:
    """Evaluate the slices of one beat at a pose.

    The prior is taken out of Jξ again: at the optimum its gradient balances that of the images.
    """
    chart = PoseChart(pose, center_mm)
    score = metric.score(pose)
    end = optimise(metric, pose, center_mm, _GaussianPrior(chart), BEAT_OPTIMISER)
    equations = metric.normal_equations(end.pose, center_mm)
    there = equations.slope
    offset = chart.coordinates(end.pose)
    information = metric.information * equations.matrix / there.left / FIXED_FIT_STIFFNESS
    gain = math.log(max(1.0 - score.similarity, 1e-12) / max(1.0 - there.similarity, 1e-12))
    return BeatMeasurement(
        pose=pose,
        best=end.pose,
        offset_information_mm=information @ offset + offset / PRIOR_SIGMA_MM**2,
        information=information,
        similarity=score.similarity,
        best_similarity=there.similarity,
        log_likelihood_ratio=max(0.5 * metric.information * gain, 0.0),
        wrong_pose_log_ratio=_wrong_pose_log_ratio(metric, PoseChart(end.pose, center_mm), there.similarity),
        moved_mm=mean_displacement_mm(pose, end.pose, center_mm),
        overlap=score.overlap,
        evaluations=end.evaluations + 2 + len(WRONG_DIRECTIONS),
    )


def _wrong_pose_log_ratio(metric: Lc2, chart: PoseChart, similarity: float) -> float:
    """Mean log-likelihood ratio of a pose with this similarity against those WRONG_MM along every axis."""
    wrong = np.array([metric.score(chart.pose(WRONG_MM * xi)).similarity for xi in WRONG_DIRECTIONS])
    gains = np.log(np.maximum(1.0 - wrong, 1e-12) / max(1.0 - similarity, 1e-12))
    return float(0.5 * metric.information * gains.mean())
