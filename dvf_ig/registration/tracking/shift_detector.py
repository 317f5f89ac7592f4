"""A shift of the heart: a generalised likelihood ratio over the last beats, against the pose before them.

Beat b, evaluated at the pose x_b, puts the heart at an offset ξ_b with information J_b (`measure_beat`). For
every k among the last WINDOW_BEATS beats, "the heart has lain at x_k + ξ since beat k" is held against "it
lies where it was estimated to be before beat k", at x_k with covariance P_k:

    Y = Σ_{b ≥ k} J_b,    y = Σ_{b ≥ k} J_b (x_b + ξ_b − x_k)
    T_k = max over ξ of twice the log-likelihood ratio = yᵀ (Y + Y P_k Y)⁻¹ y        χ² of 6 degrees if none

and the largest T_k is compared with a limit that the wanted rate of false alarms gives. One beat alone finds
a large shift, several together find one that each of them would let pass, and a drift shows against the pose
of WINDOW_BEATS beats ago even where the beats have moved the pose meanwhile.

Source: Willsky and Jones 1976, A generalized likelihood ratio approach to the detection of jumps in linear
systems; Lai 1995, Sequential changepoint detection in quality control and dynamical systems (the window).
Differs from source: the filter runs on, and the pose from before each k is kept instead of the jump's traces.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Rigid, mean_displacement_mm
from dvf_ig.registration.pose_chart import PoseChart

from .pose_estimate import PRIOR_SIGMA_MM, BeatMeasurement, PoseEstimate

WINDOW_BEATS = 8


@dataclass(frozen=True, slots=True, eq=False)
class ComparedBeat:
    """A beat that was compared with a pose: when it began, the estimate before it, and what it told."""

    begin_s: float
    estimate: PoseEstimate
    measurement: BeatMeasurement


@dataclass(frozen=True, slots=True, eq=False)
class ShiftTest:
    """The window of beats that speaks most for a shift.

    Attributes:
        statistic: T, χ² of six degrees where nothing has shifted.
        since_s: when its first beat began; beats: how many they are.
        pose: where they put the heart; distance_mm: mean distance over the heart from the pose before them.
    """

    statistic: float
    since_s: float
    beats: int
    pose: Rigid
    distance_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class ShiftDetector:
    """The last beats that were compared with the pose, oldest first."""

    compared: tuple[ComparedBeat, ...] = ()

    def after(self, begin_s: float, estimate: PoseEstimate, measurement: BeatMeasurement) -> "ShiftDetector":
        """With one more beat; `estimate` is of before it, at the pose that it was compared with."""
        newest = ComparedBeat(begin_s, estimate, measurement)
        return ShiftDetector((*self.compared[1 - WINDOW_BEATS :], newest))

    @property
    def test(self) -> ShiftTest | None:
        """Against the pose before each of the beats, the worst of them; None without a beat."""
        if not self.compared:
            return None
        newest = self.compared[-1].estimate
        chart = PoseChart(newest.pose, newest.center_mm)
        worst: tuple[float, int, FloatArray] | None = None
        total, offset_total = np.zeros((6, 6)), np.zeros(6)
        for k in range(len(self.compared) - 1, -1, -1):
            before, beat = self.compared[k].estimate, self.compared[k].measurement
            at = np.zeros(6) if before.pose is newest.pose else chart.coordinates(before.pose)
            total = total + beat.information
            offset_total = offset_total + beat.offset_information_mm + beat.information @ at
            offset = offset_total - total @ at
            covariance = total + total @ before.covariance_mm2 @ total
            statistic = float(offset @ np.linalg.lstsq(covariance, offset, rcond=None)[0])
            if worst is None or statistic > worst[0]:
                worst = (
                    statistic,
                    k,
                    np.asarray(np.linalg.solve(total + np.eye(6) / PRIOR_SIGMA_MM**2, offset)),
                )
        return None if worst is None else self._test(*worst)

    def _test(self, statistic: float, first: int, xi_mm: FloatArray) -> ShiftTest:
        beat = self.compared[first]
        pose = PoseChart(beat.estimate.pose, beat.estimate.center_mm).pose(xi_mm)
        return ShiftTest(
            statistic,
            beat.begin_s,
            len(self.compared) - first,
            pose,
            mean_displacement_mm(beat.estimate.pose, pose, beat.estimate.center_mm),
        )
