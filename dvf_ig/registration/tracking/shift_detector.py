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

from dvf_ig.core import FloatArray, Rigid, mean_displacement_mm, read_only_arrays
from dvf_ig.registration.gaussian_prior import PRIOR_SIGMA_MM
from dvf_ig.registration.pose_chart import PoseChart

from .pose_estimate import BeatMeasurement, PoseEstimate

WINDOW_BEATS = 8
UNOBSERVED = 1e-12
"""Share of the trace that makes a covariance regular in directions that no beat observes."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ComparedBeat:
    """A beat that was compared with a pose.

    Attributes:
        begin_s: when it began.
        estimate: of before it, at the pose that it was compared with; measurement: what it told.
        step_mm: (6,) that pose about the one of the beat before, in the coordinates of `PoseChart`.
    """

    begin_s: float
    estimate: PoseEstimate
    measurement: BeatMeasurement
    step_mm: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ShiftTest:
    """The window of beats that speaks most for a shift.

    Attributes:
        statistic: T, χ² of six degrees where nothing has shifted.
        since_s: when its first beat began; beats: how many they are.
        before: the estimate before them.
        offset_mm: (6,) where they put the heart, about the pose before them.
    """

    statistic: float
    since_s: float
    beats: int
    before: PoseEstimate
    offset_mm: FloatArray

    @property
    def pose(self) -> Rigid:
        """Where the beats put the heart."""
        return PoseChart(self.before.pose, self.before.center_mm).pose(self.offset_mm)

    @property
    def distance_mm(self) -> float:
        """Mean distance over the heart from the pose before the beats."""
        return mean_displacement_mm(self.before.pose, self.pose, self.before.center_mm)


@dataclass(frozen=True, slots=True, eq=False)
class ShiftDetector:
    """The last beats that were compared with the pose, oldest first."""

    compared: tuple[ComparedBeat, ...] = ()

    def after(self, begin_s: float, estimate: PoseEstimate, measurement: BeatMeasurement) -> "ShiftDetector":
        """With one more beat; `estimate` is of before it, at the pose that it was compared with."""
        step = np.zeros(6)
        if self.compared and self.compared[-1].estimate.pose is not estimate.pose:
            step = PoseChart(self.compared[-1].estimate.pose, estimate.center_mm).coordinates(estimate.pose)
        newest = ComparedBeat(begin_s, estimate, measurement, step)
        return ShiftDetector((*self.compared[1 - WINDOW_BEATS :], newest))

    @property
    def test(self) -> ShiftTest | None:
        """Against the pose before each of the beats, the worst of them; None without a beat.

        Steps from pose to pose are small, and add.
        """
        worst: ShiftTest | None = None
        at, total, offset_total = np.zeros(6), np.zeros((6, 6)), np.zeros(6)
        for count, beat in enumerate(reversed(self.compared), start=1):
            told = beat.measurement
            total = total + told.information
            offset_total = offset_total + told.offset_information_mm + told.information @ at
            offset = offset_total - total @ at
            covariance = total + total @ beat.estimate.covariance_mm2 @ total
            covariance += UNOBSERVED * np.trace(covariance) * np.eye(6)
            statistic = float(offset @ np.linalg.solve(covariance, offset))
            if worst is None or statistic > worst.statistic:
                xi = np.asarray(np.linalg.solve(total + np.eye(6) / PRIOR_SIGMA_MM**2, offset))
                worst = ShiftTest(statistic, beat.begin_s, count, beat.estimate, xi)
            at = at - beat.step_mm
        return worst
