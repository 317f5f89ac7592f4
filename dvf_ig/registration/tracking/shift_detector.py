"""A shift of the heart: a generalised likelihood ratio over the last beats, against the pose before them.

Beat b, evaluated at the pose x_b, puts the heart at an offset ξ_b with information J_b (`measure_beat`). For
every k among the last WINDOW_BEATS beats, "the heart has lain at x_k + ξ since beat k" is held against "it
lies where it was estimated to be before beat k", at x_k with covariance P_k:

    Y = Σ_{b ≥ k} J_b,    y = Σ_{b ≥ k} J_b (x_b + ξ_b − x_k)
    T_k = max over ξ of twice the log-likelihood ratio = yᵀ (Y + Y P_k Y)⁻¹ y        χ² of 6 degrees if none

and the largest T_k is compared with a limit that the wanted rate of false alarms gives. One beat alone finds
a large shift, several together find one that each of them would let pass, and a drift shows against the pose
of WINDOW_BEATS beats ago even where the beats have moved the pose meanwhile.

Hearts differ in how far their beats scatter: where model and patient, or the images, agree less, J promises
too much. So J is divided by what the beats before the window had for a variance: the mean of their own
statistics over its expectation, 6, where that is more than 1. A shift does not raise it before it has been in
the window for WINDOW_BEATS beats.

Source: Willsky and Jones 1976, A generalized likelihood ratio approach to the detection of jumps in linear
systems; Lai 1995, Sequential changepoint detection in quality control and dynamical systems (the window).
Differs from source: the filter runs on, the pose from before each k is kept instead of the jump's traces, and
the noise is estimated on the way.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, Rigid, mean_displacement_mm, read_only_arrays
from dvf_ig.registration.lc2.optimise import PRIOR_SIGMA_MM
from dvf_ig.registration.pose_chart import PoseChart

from .pose_estimate import LARGEST, BeatMeasurement, PoseEstimate

WINDOW_BEATS = 8
"""Beats among which a shift may have begun."""
UNOBSERVED = 1e-12
"""Share of the trace that makes a covariance regular in directions that no beat observes."""
SCATTER_BEATS, PRESUMED_BEATS = 30, 5
"""Beats before the window whose scatter counts, and beats that scatter as they should, presumed before them.
On tuning hearts 1001–1010, 240 s each, 20 or 60 and 2 or 10 do as well."""
DEGREES_OF_FREEDOM = 6
"""Degrees of freedom of a pose: mean of a beat's statistic if its information is right."""
LARGEST_SCATTER = 60.0
"""Statistic of one beat, above which it counts as this."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ComparedBeat:
    """A beat that was compared with a pose.

    Attributes:
        begin_s: when it began.
        estimate: of before it, at the pose that it was compared with; measurement: what it told.
        step_mm: (6,) where images match at that pose, about where they did at the one of the beat before, in
            the coordinates of `PoseChart`: how shape pulls images aside may be said anew and shifts nothing.
    """

    begin_s: float
    estimate: PoseEstimate
    measurement: BeatMeasurement
    step_mm: FloatArray

    @property
    def statistic(self) -> float:
        """χ² of six degrees of this beat alone, where nothing has shifted and its information is right."""
        measurement = self.measurement
        return _statistic(
            measurement.offset_information_mm, measurement.information, self.estimate.covariance_mm2
        )


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
        return PoseChart(self.before.moved_by_beats, self.before.center_mm).pose(self.offset_mm)

    @property
    def distance_mm(self) -> float:
        """Mean distance over the heart from the pose before the beats."""
        return mean_displacement_mm(self.before.moved_by_beats, self.pose, self.before.center_mm)


@dataclass(frozen=True, slots=True, eq=False)
class ShiftDetector:
    """The last beats that were compared with the pose, and how far those before them scattered.

    Attributes:
        compared: the window, oldest first.
        scatter: statistics of single beats that have left it, oldest first.
    """

    compared: tuple[ComparedBeat, ...] = ()
    scatter: tuple[float, ...] = ()

    def restarted(self) -> "ShiftDetector":
        """Without beats, for another pose of the same heart in the same images."""
        return ShiftDetector(scatter=self.scatter)

    def after(
        self, begin_s: float, estimate: PoseEstimate, measurement: BeatMeasurement, *, in_use: bool = True
    ) -> "ShiftDetector":
        """With one more beat.

        Args:
            estimate: of before it, at the pose that it was compared with.
            in_use: that pose was; otherwise it may be wrong, and tells nothing of how beats scatter.
        Raises:
            InvalidInputError: a time or an estimate that is not finite, which would stay in the window.
        """
        matched = estimate.matched_pose
        _require_known(begin_s, estimate.covariance_mm2, matched)
        step = np.zeros(6)
        if self.compared and self.compared[-1].estimate is not estimate:
            before = PoseChart(self.compared[-1].estimate.matched_pose, estimate.center_mm)
            step = before.coordinates(matched)
        newest = ComparedBeat(begin_s, estimate, measurement, step)
        compared, scatter = (*self.compared, newest), self.scatter
        if len(compared) > WINDOW_BEATS:
            if in_use:
                scatter = (*scatter, min(compared[0].statistic, LARGEST_SCATTER))[-SCATTER_BEATS:]
            compared = compared[1:]
        return ShiftDetector(compared, scatter)

    @property
    def variance(self) -> float:
        """Scatter of beats over what their information promises, at least 1."""
        beats = PRESUMED_BEATS + len(self.scatter)
        return max(1.0, (PRESUMED_BEATS + sum(self.scatter) / DEGREES_OF_FREEDOM) / beats)

    @property
    def test(self) -> ShiftTest | None:
        """Against the pose before each of the beats, the worst of them; None without a beat.

        Steps from pose to pose are small, and add.
        """
        worst: ShiftTest | None = None
        at, total, offset_total, share = np.zeros(6), np.zeros((6, 6)), np.zeros(6), 1.0 / self.variance
        for count, beat in enumerate(reversed(self.compared), start=1):
            measurement = beat.measurement
            total = total + share * measurement.information
            offset_total = offset_total + share * (
                measurement.offset_information_mm + measurement.information @ at
            )
            offset = offset_total - total @ at
            statistic = _statistic(offset, total, beat.estimate.covariance_mm2)
            if worst is None or statistic > worst.statistic:
                xi = np.asarray(np.linalg.solve(total + np.eye(6) / PRIOR_SIGMA_MM**2, offset))
                worst = ShiftTest(statistic, beat.begin_s, count, beat.estimate, xi)
            at = at - beat.step_mm
        return worst


def _require_known(begin_s: float, covariance_mm2: FloatArray, matched: Rigid) -> None:
    known = (begin_s, covariance_mm2, matched.translation_mm)
    if not all((np.abs(values) <= LARGEST).all() for values in known):
        raise InvalidInputError(
            f"a beat at {begin_s:g} s was compared with a pose that is not known; needed finite numbers "
            f"below {LARGEST:g}"
        )


def _statistic(offset_information_mm: FloatArray, information: FloatArray, known_mm2: FloatArray) -> float:
    """χ² of six degrees of an offset (6,), given as Yξ with its information Y, from a pose known to P."""
    if not information.any():
        return 0.0
    covariance = information + information @ known_mm2 @ information
    covariance += UNOBSERVED * np.trace(covariance) * np.eye(6)
    return float(offset_information_mm @ np.linalg.solve(covariance, offset_information_mm))
