"""A patient whose pose is known at all times, and what ultrasound of that pose would say."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Rigid, Stop, mean_displacement_mm
from dvf_ig.registration import (
    BeatMeasurement,
    Evidence,
    ImageStatistics,
    PoseChart,
    RegistrationOptions,
    RegistrationResult,
)
from dvf_ig.session.beat_evaluation import BEAT_COMPUTE_S, BeatEvaluation

DETECTION_S, SIGMA_MM = 0.12, 0.8
"""An R peak is detected so long after it; a beat tells each coordinate of the pose so well."""

Patient = Callable[[float], FloatArray]
"""Time to the six coordinates of the true pose about that at rest."""


def still(t_s: float) -> FloatArray:
    return np.zeros(6)


@dataclass(frozen=True, slots=True)
class KnownBeat:
    """A beat whose ultrasound shows where the patient was half-way through it."""

    begin_s: float
    end_s: float
    pose: Rigid

    def evaluate_beat(self, pose: Rigid, center_mm: FloatArray, *, in_use: bool) -> BeatEvaluation:
        information = np.eye(6) / SIGMA_MM**2
        offset = PoseChart(pose, center_mm).coordinates(self.pose)
        measurement = BeatMeasurement(
            pose=pose,
            best=self.pose,
            offset_information_mm=information @ offset,
            information=information,
            similarity=0.4,
            best_similarity=0.6,
            log_likelihood_ratio=float(0.5 * offset @ information @ offset),
            wrong_pose_log_ratio=12.0,
            moved_mm=mean_displacement_mm(pose, self.pose, center_mm),
            overlap=1.0,
            evaluations=1,
        )
        detected_s = self.end_s + DETECTION_S
        decided_s = detected_s + BEAT_COMPUTE_S
        return BeatEvaluation(
            self.begin_s, self.end_s, detected_s, decided_s, 10, measurement, in_use, 0.01, np.zeros((3, 3))
        )


def registration(pose: Rigid, center_mm: FloatArray) -> RegistrationResult:
    """A registration that ended at `pose` and found nothing against itself."""
    covariance = np.diag([(0.4 / 40) ** 2] * 3 + [0.4**2] * 3)
    return RegistrationResult(
        target_from_source=pose,
        start=pose,
        stop=Stop.CONVERGED,
        success_probability=1.0,
        tre_bound_mm=2.0,
        covariance=covariance,
        noise_covariance=covariance,
        center_mm=center_mm,
        similarity=0.6,
        start_similarity=0.5,
        overlap=1.0,
        evidence=Evidence(z_score=10.0, split_half_mm=0.2, phase_mm=0.5),
        statistics=ImageStatistics(0.3, 0.8, 0.8, 0.9, 48.0, 30.0, 25.0, 0.6, 1.0, 300.0),
        outside="",
        second_best=0.0,
        moved_mm=1.0,
        evaluations=1,
        seconds=1.0,
        slices=48,
        options=RegistrationOptions(),
    )
