"""Motion of the heart in breathing as a session learns it, from the beats that it compares with a pose.

    gate     until the motion is learnt: frames and forces at end-expiration alone
    model    afterwards: frames are moved back to rest, and the pose follows the breath, where it is known

All other parts of a session see the heart at rest, which is end-expiration.
"""

from collections import deque
from dataclasses import dataclass
from math import inf, nan

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.cardiac.respiration import RELEARN_BREATHS, Breath
from dvf_ig.core import HEART_RADIUS_MM, BoolArray, FloatArray, IntArray, PoseMotion, read_only_arrays
from dvf_ig.registration import (
    MEAN_SQUARE_OF_COORDINATES,
    BeatMeasurement,
    BreathBeat,
    BreathingPose,
    PoseChart,
    learn_breathing,
    misfits,
)

REST_SHARE = 0.3
"""Share of the time in which ρ and its lags are lowest, and the heart rests."""
FIRST_BREATHS, TRUSTED_BREATHS = 4, 10
"""Breaths from which a model helps to compare the next beats, and from which forces may follow it."""
MAX_HELD_OUT_MM = 2.0
"""Largest error in held-out breaths of a model that forces may follow."""
REMEMBERED_BREATHS = 40
LATENCIES_S = np.arange(-0.6, 0.41, 0.05)
"""Latencies of ρ that are compared."""
LATENCY_BREATHS = 5
"""They are compared again after so many breaths."""
KNOWN_SHARE, LONGEST_BREATH_S = 0.8, 30.0
"""A breath of which less was learnt lies outside; a longer one is a pause."""
COURSE_POINTS = 72
"""Moments of a breath in the mean course that is recorded."""
AHEAD_S = 0.1
"""A published motion reaches this far, if no sample replaces it before."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class FrameBreathing:
    """Breathing at the moments of n frames, as known when they were gathered.

    Attributes:
        event_s: (n,) what they show happened then.
        features: (n, 4) s; NaN where it is not known.
        resting: (n,) at end-expiration, where nothing has to be known of the motion.
        xi_mm: (n, 6) motion from rest by the model; zero without one.
        known: (n,) the model knows the motion; all False without one that may be used.
        learnt: forces follow the model.
    """

    event_s: FloatArray
    features: FloatArray
    resting: BoolArray
    xi_mm: FloatArray
    known: BoolArray
    learnt: bool

    @property
    def usable(self) -> BoolArray:
        """(n,) frames of the resting heart, or that can be moved to it."""
        return np.asarray(self.known if self.learnt else self.resting)

    @property
    def known_breath(self) -> BoolArray:
        """(n,) frames whose place in the breath is known."""
        return np.asarray(np.isfinite(self.features).all(axis=1))

    def part(self, chosen: IntArray | slice) -> "FrameBreathing":
        """Choose frames."""
        return FrameBreathing(
            self.event_s[chosen],
            self.features[chosen],
            self.resting[chosen],
            self.xi_mm[chosen],
            self.known[chosen],
            self.learnt,
        )


def moved_to_rest(
    rotations: FloatArray, translations_mm: FloatArray, xi_mm: FloatArray, chart: PoseChart
) -> tuple[FloatArray, FloatArray]:
    """Move (n, 3, 3), (n, 3) tracker_from_probe so that, at the chart's pose, they see the heart at rest.

    The pose of the moment is exp(ξ) M: M⁻¹ exp(ξ) M tracker_from_probe.
    """
    base, center = chart.base, chart.center_mm
    turn = Rotation.from_rotvec(xi_mm[:, :3] / HEART_RADIUS_MM).as_matrix()
    in_model = base.rotation @ rotations
    at = translations_mm @ base.rotation.T + base.translation_mm
    at = np.einsum("nij,nj->ni", turn, at - center) + center + xi_mm[:, 3:]
    back = base.rotation.T
    return back @ turn @ in_model, (at - base.translation_mm) @ back.T


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class FollowedBreath:
    """The mean of the last breaths, with the motion of the heart that was learnt by then.

    Attributes:
        model: of the motion; beats: from which it was learnt.
        rest: (4,) features from which the motion counts.
        t_s: (breaths, n) times at even shares of each breath; features: (n, 4) mean then.
    """

    model: BreathingPose
    beats: tuple[BreathBeat, ...]
    rest: FloatArray
    t_s: FloatArray
    features: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _TimedBeat:
    """A beat with the times of its frames, (m,)."""

    beat: BreathBeat
    frames_s: FloatArray


class LearntMotion:
    """The motion of the heart with one breathing clock, and how well it is known.

    Args:
        center_mm: (3,) centre of the heart, model frame.
        clock: of breathing.
    """

    def __init__(self, center_mm: FloatArray, clock: Breath) -> None:
        self.clock = clock
        self.learnt = False
        """Whether forces follow the model."""
        self._center_mm = center_mm
        self._beats: deque[_TimedBeat] = deque()
        self._model: BreathingPose | None = None
        self._rest = np.array([1.0, 0.0, 0.0, 0.0])
        self._rest_level, self._rest_level_s = nan, -inf
        self._breath = 0
        self._last_onset_s = -inf
        self._unknown_breaths = 0
        self._latency_s, self._latency_breath = nan, -LATENCY_BREATHS

    @property
    def model(self) -> BreathingPose | None:
        """The model that forces follow; None before it is learnt."""
        return self._model if self.learnt else None

    @property
    def excursion_mm(self) -> float | None:
        """RMS motion over the heart from rest to the top of a breath; None before TRUSTED_BREATHS."""
        model = self._model
        if model is None or model.breaths < TRUSTED_BREATHS:
            return None
        xi_mm = self._xi_mm(model, np.ones((1, 4)))[0]
        return float(np.sqrt(MEAN_SQUARE_OF_COORDINATES @ np.square(xi_mm)))

    @property
    def astray(self) -> bool:
        """Whether RELEARN_BREATHS breaths in a row lay outside of what was learnt."""
        return self._unknown_breaths >= RELEARN_BREATHS

    def advance(self, now_s: float) -> bool:
        """Follow the clock until now; whether a breath has begun, from which the motion was learnt again."""
        if now_s >= self._rest_level_s + 1.0:
            self._rest_level, self._rest_level_s = self.clock.rest_level(REST_SHARE), now_s
        onsets = self.clock.onsets_s
        if not onsets or onsets[-1] <= self._last_onset_s:
            return False
        self._count_unknown(self._last_onset_s, onsets[-1])
        self._last_onset_s = onsets[-1]
        self._breath += 1
        return self._learn()

    def features(self, t_s: FloatArray) -> FloatArray:
        """Compute (n, 4) features; NaN also where they do not tell where the heart is."""
        features = self.clock.features(t_s)
        if np.isfinite(features).any():
            features[~self.clock.tells(t_s)] = nan
        return features

    def rests(self, features: FloatArray) -> BoolArray:
        """Return whether the heart rests at (n, 4) features."""
        return np.asarray(features[:, 1:].max(axis=1) <= self._rest_level)

    def frames(self, event_s: FloatArray) -> FrameBreathing:
        """Return breathing at the moments of frames."""
        features = self.features(event_s)
        valid, xi = np.zeros(len(event_s), dtype=np.bool_), np.zeros((len(event_s), 6))
        if self._model is not None:
            valid = self._model.knows(features)
            xi[valid] = self._xi_mm(self._model, features[valid])
        return FrameBreathing(event_s, features, self.rests(features), xi, valid, self.learnt)

    def add_beat(self, measurement: BeatMeasurement, frames: FrameBreathing) -> None:
        """Learn from a beat that was compared with a pose after its frames were moved by `frames`.

        What it then still finds is added to the mean motion of its frames.
        """
        good = frames.known_breath
        if not measurement.informative or not good.any():
            return
        beat = BreathBeat(
            frames.features[good].mean(axis=0),
            frames.features[good],
            measurement.information,
            measurement.offset_information_mm + measurement.information @ frames.xi_mm[good].mean(axis=0),
            self._breath,
        )
        self._beats.append(_TimedBeat(beat, frames.event_s[good]))
        while self._beats[0].beat.breath < self._breath - REMEMBERED_BREATHS:
            self._beats.popleft()

    def motion(self, resting: PoseMotion, now_s: float) -> PoseMotion:
        """Return the pose of the moment, with its rate, from that of the resting heart."""
        if self.model is None:
            return resting
        features = self.features(np.array([now_s, now_s + AHEAD_S]))
        if not self.model.knows(features[:1])[0] or not np.isfinite(features).all():
            return resting
        now, then = self._xi_mm(self.model, features)
        end_s = now_s + AHEAD_S
        start = PoseChart(resting.at(now_s), self._center_mm).pose(now)
        end = PoseChart(resting.at(end_s), self._center_mm).pose(then)
        return PoseMotion.between(start, end, now_s, end_s, self._center_mm)

    def covariance_mm2(self, features: FloatArray, sigma_rho: float) -> FloatArray:
        """Compute (6, 6) covariance of the motion from rest at (4,) features; zero before a first model.

        In the gate the heart is taken to be at rest, so that the motion that is left is the error.
        """
        model = self._model
        if model is None:
            return np.zeros((6, 6))
        beyond = (features - self._rest)[None]
        xi_mm = model.xi_mm(beyond)[0]
        covariance = model.covariance_mm2(beyond)[0] if self.learnt else np.outer(xi_mm, xi_mm)
        return np.asarray(covariance + sigma_rho**2 * np.outer(model.b_mm[1], model.b_mm[1]))

    def displacement_mm(self, features: FloatArray) -> float:
        """Compute `BreathingPose.displacement_mm` from rest at (4,) features; NaN before forces follow it."""
        model = self.model
        return nan if model is None else float(model.displacement_mm((features - self._rest)[None])[0])

    def usual_breath(self) -> FollowedBreath | None:
        """Return the mean of the last breaths known whole; None without any, or without a model in use."""
        onsets_s = np.array(self.clock.onsets_s)
        if self.model is None or len(onsets_s) < 2:
            return None
        t_s = onsets_s[:-1, None] + np.diff(onsets_s)[:, None] * np.arange(COURSE_POINTS) / COURSE_POINTS
        features = self.features(t_s.ravel()).reshape(*t_s.shape, -1)
        finite = np.isfinite(features).all(axis=(1, 2))
        if not finite.any():
            return None
        beats = tuple(one.beat for one in self._beats)
        return FollowedBreath(self.model, beats, self._rest, t_s[finite], features[finite].mean(axis=0))

    @property
    def latency_s(self) -> float:
        """How far ρ is behind the heart, as of one of the last breaths."""
        if self._breath >= self._latency_breath + LATENCY_BREATHS:
            self._latency_s, self._latency_breath = self._best_latency_s(), self._breath
        return self._latency_s

    def _best_latency_s(self) -> float:
        """Find the shift of ρ alone that best explains the beats."""
        frames_s = np.concatenate([one.frames_s for one in self._beats])
        begins = np.cumsum([0, *(len(one.frames_s) for one in self._beats)])[:-1]
        counts = np.diff([*begins, len(frames_s)])[:, None]
        shifted = np.array([self.features(frames_s + late_s) for late_s in LATENCIES_S.tolist()])
        shifted[:, :, 2:] *= 0.0  # a gap stays NaN
        means = np.array([np.add.reduceat(one, begins, axis=0) / counts for one in shifted])
        return float(LATENCIES_S[misfits(tuple(one.beat for one in self._beats), means).argmin()])

    def _xi_mm(self, model: BreathingPose, features: FloatArray) -> FloatArray:
        """Compute the motion from rest at (n, 4) features."""
        return model.xi_mm(features - self._rest)

    def _count_unknown(self, begin_s: float, end_s: float) -> None:
        """Count breaths in a row that lie outside of what was learnt."""
        if self.model is None or not end_s - begin_s < LONGEST_BREATH_S:
            return
        features = self.features(np.arange(begin_s, end_s, 0.1))
        familiar = self.model.knows(features[np.isfinite(features).all(axis=1)])
        outside = len(familiar) > 0 and familiar.mean() < KNOWN_SHARE
        self._unknown_breaths = self._unknown_breaths + 1 if outside else 0

    def _learn(self) -> bool:
        """Learn again with every breath; until forces follow it, the rest is that of the gate."""
        if len({one.beat.breath for one in self._beats}) < FIRST_BREATHS:
            return False
        model = learn_breathing(tuple(one.beat for one in self._beats))
        if model is None:
            return False
        if not self.learnt:
            self._rest = self.clock.rest_features(REST_SHARE)
        self._model = model
        trusted = model.breaths >= TRUSTED_BREATHS and model.held_out_mm <= MAX_HELD_OUT_MM
        self.learnt |= trusted and self.clock.continuous
        return self.learnt
