"""Breathing in a session: from what follows the breath to frames at rest, and the pose of the moment.

    gate     until the motion is learnt: frames and forces at end-expiration alone
    model    afterwards: frames are moved back to rest, and the pose follows the breath, where it is known

All other parts of a session see the heart at rest, which is end-expiration.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import floor, inf, nan

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.cardiac.respiration import (
    PARTING,
    RELEARN_BREATHS,
    BreathClock,
    BreathClockOptions,
    BreathEvent,
    BreathReading,
    BreathState,
    RelearningClock,
)
from dvf_ig.core import HEART_RADIUS_MM, BoolArray, FloatArray, IntArray, PoseMotion, read_only_arrays
from dvf_ig.registration import (
    MEAN_SQUARE_OF_COORDINATES,
    BeatMeasurement,
    BreathBeat,
    BreathingPose,
    OscillationWatch,
    PoseChart,
    learn_breathing,
    misfits,
)

from .clocks import StampOrder
from .events import RespirationSample
from .reasons import BreathingReason

REST_SHARE = 0.3
"""Share of the time in which ρ and its lags are lowest, and the heart rests."""
FIRST_BREATHS, TRUSTED_BREATHS = 4, 10
"""Breaths from which a model helps to compare the next beats, and from which forces may follow it."""
MAX_HELD_OUT_MM = 2.0
"""Largest error in held-out breaths of a model that forces may follow."""
REMEMBERED_BREATHS = 40
LATENCIES_S = np.arange(-0.6, 0.41, 0.05)
"""Latencies of ρ that are compared."""
KNOWN_SHARE, LONGEST_BREATH_S = 0.8, 30.0
"""A breath of which less was learnt lies outside; a longer one is a pause."""
LOST_S = BreathClockOptions().lost_s
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


@dataclass(frozen=True, slots=True)
class BreathingRecord:
    """What a session has found about the motion in breathing.

    Attributes:
        from_s: when; the motion that forces follow is learnt again with every breath.
        breaths: number of breaths it was learnt from; None if nothing follows the breath.
        held_out_mm: its error in breaths that it was not learnt from, as in `BreathingPose`.
        latency_s: how far what follows the breath is behind the heart; negative if it is ahead.
        unfollowed_mm, per_minute: motion and rate of breaths that heart beats show, if nothing follows them.
    """

    from_s: float
    breaths: int | None = None
    held_out_mm: float | None = None
    latency_s: float | None = None
    unfollowed_mm: float | None = None
    per_minute: float | None = None


def no_log(_: BreathingRecord) -> None:
    """Log nothing."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Moment:
    """What holds from one sample to the next: whether and why the pose is withheld, how well it is known."""

    changed_s: float
    withheld: bool
    covariance_mm2: FloatArray
    bound_mm: float
    reason: str | None


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
class _TimedBeat:
    """A beat with the times of its frames, (m,)."""

    beat: BreathBeat
    frames_s: FloatArray


class BreathingTracker:
    """The clock, the learning and the motion; one without samples never has an effect.

    Args:
        center_mm: (3,) centre of the heart, model frame.
        log: called with what is found.
    """

    def __init__(self, center_mm: FloatArray, log: Callable[[BreathingRecord], None] = no_log) -> None:
        self._log = log
        self.order = StampOrder()
        self._changed = False  # for good, and not learnt again yet
        self._center_mm = center_mm
        self._following = RelearningClock()
        self._changes = 0
        self._waiting: deque[RespirationSample] = deque()
        self._beats: deque[_TimedBeat] = deque()
        self._model: BreathingPose | None = None
        self._learnt = False
        self._rest = np.array([1.0, 0.0, 0.0, 0.0])
        self._breath = 0
        self._last_onset_s = -inf
        self._unknown_breaths = 0
        self._rest_level, self._rest_level_s = nan, -inf
        self._watch = OscillationWatch(center_mm)
        self._watch_changed_s = -inf
        self._known = _Moment(nan, False, np.zeros((6, 6)), 0.0, None)

    def watch(self, middle_s: float, decided_s: float, measurement: BeatMeasurement) -> None:
        """Look for breathing in the poses of beats if nothing follows the breath."""
        if self.follows:
            return
        before = self._watch.found
        self._watch.add(middle_s, measurement)
        if (self._watch.found is None) is not (before is None):
            self._watch_changed_s = decided_s
            found = self._watch.found
            if found is not None:
                moved_mm, per_minute = 2.0 * found.amplitude_mm, found.per_minute
                self._log(BreathingRecord(decided_s, unfollowed_mm=moved_mm, per_minute=per_minute))

    def shifted(self, from_s: float) -> None:
        """Watch for breathing from then on at another place of the heart."""
        self._watch.shifted(from_s)

    @property
    def _clock(self) -> BreathClock:
        return self._following.clock

    @property
    def follows(self) -> bool:
        """Whether anything follows the breath; without, no breathing is expected."""
        return self.order.newest_s > -inf

    @property
    def model(self) -> BreathingPose | None:
        """The model that forces follow; None before it is learnt."""
        return self._model if self._learnt else None

    def push(self, sample: RespirationSample) -> bool:
        """Add a sample; False if its stamp is not later than those before."""
        if not self.order.accepts(sample.t_s):
            return False
        self._waiting.append(sample)
        return True

    def advance(self, now_s: float) -> None:
        """Take the samples until now."""
        self.order.advance(now_s)
        while self._waiting and self._waiting[0].t_s <= now_s:
            sample = self._waiting.popleft()
            self._following.push(np.array([sample.t_s]), sample.values[None])
        if self._following.changes > self._changes:
            self._changes = self._following.changes
            self._forget()
        if now_s >= self._rest_level_s + 1.0:
            self._rest_level, self._rest_level_s = self._clock.rest_level(REST_SHARE), now_s
        onsets = self._clock.onsets_s
        if onsets and onsets[-1] > self._last_onset_s:
            self._count_unknown(self._last_onset_s, onsets[-1])
            self._last_onset_s = onsets[-1]
            self._breath += 1
            self._learn(now_s)

    def reading(self, now_s: float) -> BreathReading:
        """Read the clock."""
        return self._clock.reading(now_s)

    def frames(self, event_s: FloatArray) -> FrameBreathing | None:
        """Return breathing at the moments of frames; None if nothing follows the breath."""
        if not self.follows:
            return None
        features = self._features(event_s)
        resting = np.asarray(features[:, 1:].max(axis=1) <= self._rest_level)
        if self._model is None:
            nothing = np.zeros(len(event_s), dtype=np.bool_)
            return FrameBreathing(event_s, features, resting, np.zeros((len(event_s), 6)), nothing, False)
        known = self._model.knows(features)
        xi = np.where(known[:, None], self._xi_mm(self._model, features), 0.0)
        return FrameBreathing(event_s, features, resting, xi, known, self._learnt)

    def add_beat(self, measurement: BeatMeasurement, frames: FrameBreathing) -> None:
        """Learn from a beat that was compared with a pose after its frames were moved by `frames`.

        What it then still finds is added to the mean motion of its frames.
        """
        good = np.isfinite(frames.features).all(axis=1)
        if not measurement.informative or not good.any():
            return
        xi = frames.xi_mm[good].mean(axis=0)
        beat = BreathBeat(
            frames.features[good].mean(axis=0),
            frames.features[good],
            measurement.information,
            measurement.offset_information_mm + measurement.information @ xi,
            self._breath,
        )
        self._beats.append(_TimedBeat(beat, frames.event_s[good]))
        while self._beats[0].beat.breath < self._breath - REMEMBERED_BREATHS:
            self._beats.popleft()

    def motion(self, resting: PoseMotion, now_s: float) -> PoseMotion:
        """Return the pose of the moment, with its rate, from that of the resting heart."""
        if self._model is None or not self._learnt:
            return resting
        features = self._features(np.array([now_s, now_s + AHEAD_S]))
        if not self._model.knows(features[:1])[0] or not np.isfinite(features).all():
            return resting
        now, then = self._xi_mm(self._model, features)
        end_s = now_s + AHEAD_S
        start = PoseChart(resting.at(now_s), self._center_mm).pose(now)
        end = PoseChart(resting.at(end_s), self._center_mm).pose(then)
        return PoseMotion.between(start, end, now_s, end_s, self._center_mm)

    def covariance_mm2(self, now_s: float) -> FloatArray:
        """Return (6, 6) covariance of the motion from rest now; zero without a model in use."""
        return self._moment(now_s).covariance_mm2

    def bound_mm(self, now_s: float) -> float:
        """Return twice the RMS error of that motion over the heart."""
        return self._moment(now_s).bound_mm

    def changed_s(self, now_s: float) -> float:
        """Return when what `motion` and `withheld` give last changed.

        That is the latest sample, the end of each motion that is published without another one, or the loss;
        if nothing follows the breath, when beats began or ceased to show it.
        """
        if not self.follows:
            return self._watch_changed_s
        latest_s = self._clock.latest_s
        silent_s = now_s - latest_s
        if not silent_s >= AHEAD_S:
            return latest_s
        if silent_s > LOST_S:
            return latest_s + LOST_S
        return latest_s + min(AHEAD_S * floor(silent_s / AHEAD_S), LOST_S - AHEAD_S)

    def withheld(self, now_s: float) -> bool:
        """Whether the pose of the moment is not known: beyond what was learnt, or before it, not at rest."""
        return self._moment(now_s).withheld

    def reason(self, now_s: float) -> str | None:
        """Return why the pose is withheld or serves at rest alone, as a sentence; None if it does neither."""
        return self._moment(now_s).reason

    def _moment(self, now_s: float) -> "_Moment":
        """Return what holds since the latest sample, computed once."""
        changed_s = self.changed_s(now_s)
        if changed_s != self._known.changed_s:
            self._known = self._evaluated(changed_s, now_s)
        return self._known

    def _evaluated(self, changed_s: float, now_s: float) -> "_Moment":
        nothing = np.zeros((6, 6))
        if not self.follows:
            return self._without_surrogate(changed_s)
        reading, features = self._clock.reading(now_s), self._features(np.array([now_s]))
        if reading.state is BreathState.INIT:
            return _Moment(changed_s, True, nothing, 0.0, BreathingReason.NO_BREATH.value)
        if reading.state is BreathState.LOST:
            return _Moment(changed_s, True, nothing, 0.0, BreathingReason.LOST.value)
        if reading.event in PARTING or not np.isfinite(features).all():
            event = BreathEvent.DISCONNECTION if reading.event is BreathEvent.NONE else reading.event
            reason = BreathingReason.NOT_ORDINARY.value.format(what=event.name.lower().replace("_", " "))
            return _Moment(changed_s, True, nothing, 0.0, reason)
        model = self.model
        if model is None:
            cause = BreathingReason.CHANGED if self._changed else BreathingReason.LEARNING
            withheld = not features[0, 1:].max() <= self._rest_level
            return _Moment(changed_s, withheld, nothing, 0.0, cause.value)
        covariance = model.covariance_mm2(features - self._rest)[0]
        covariance += reading.sigma_rho**2 * np.outer(model.b_mm[1], model.b_mm[1])
        bound_mm = float(2.0 * np.sqrt(MEAN_SQUARE_OF_COORDINATES @ np.diag(covariance)))
        withheld = not model.knows(features)[0]
        outside = BreathingReason.NOT_LEARNT.value if withheld else None
        return _Moment(changed_s, bool(withheld), covariance, bound_mm, outside)

    def _without_surrogate(self, changed_s: float) -> "_Moment":
        found, reason = self._watch.found, None
        if found is not None:
            template = BreathingReason.NOT_FOLLOWED.value
            reason = template.format(mm=2.0 * found.amplitude_mm, per_minute=found.per_minute)
        return _Moment(changed_s, found is not None, np.zeros((6, 6)), 0.0, reason)

    def _features(self, t_s: FloatArray) -> FloatArray:
        """Compute (n, 4) features; NaN also where they do not tell where the heart is."""
        features = self._clock.features(t_s)
        if np.isfinite(features).any():
            features[~self._clock.tells(t_s)] = nan
        return features

    def _latency_s(self) -> float:
        """Estimate how far ρ is behind the heart: the shift of ρ alone that best explains the beats."""
        frames_s = np.concatenate([one.frames_s for one in self._beats])
        begins = np.cumsum([0, *(len(one.frames_s) for one in self._beats)])[:-1]
        counts = np.diff([*begins, len(frames_s)])[:, None]
        shifted = np.array([self._features(frames_s + late_s) for late_s in LATENCIES_S.tolist()])
        shifted[:, :, 2:] *= 0.0  # a gap stays NaN
        means = np.array([np.add.reduceat(one, begins, axis=0) / counts for one in shifted])
        misfit = misfits(tuple(one.beat for one in self._beats), means)
        return float(LATENCIES_S[misfit.argmin()])

    def _xi_mm(self, model: BreathingPose, features: FloatArray) -> FloatArray:
        """Compute the motion from rest at (n, 4) features."""
        return model.xi_mm(features - self._rest)

    def _count_unknown(self, begin_s: float, end_s: float) -> None:
        """Count breaths in a row that lie outside of what was learnt; after RELEARN_BREATHS forget it."""
        if self._model is None or not self._learnt or not end_s - begin_s < LONGEST_BREATH_S:
            return
        features = self._features(np.arange(begin_s, end_s, 0.1))
        known = self._model.knows(features[np.isfinite(features).all(axis=1)])
        outside = len(known) > 0 and known.mean() < KNOWN_SHARE
        self._unknown_breaths = self._unknown_breaths + 1 if outside else 0
        if self._unknown_breaths >= RELEARN_BREATHS:
            self._forget()

    def _forget(self) -> None:
        """Begin again with the gate: breathing has changed for good."""
        self._beats.clear()
        self._model, self._learnt, self._unknown_breaths = None, False, 0
        self._rest_level_s = self._last_onset_s = -inf
        self._changed = True

    def _learn(self, now_s: float) -> None:
        """Learn again with every breath; until forces follow it, the rest is that of the gate."""
        breaths = len({one.beat.breath for one in self._beats})
        if breaths < FIRST_BREATHS:
            return
        model = learn_breathing(tuple(one.beat for one in self._beats))
        if model is None:
            return
        if not self._learnt:
            self._rest = self._clock.rest_features(REST_SHARE)
        self._model = model
        self._learnt |= model.breaths >= TRUSTED_BREATHS and model.held_out_mm <= MAX_HELD_OUT_MM
        self._changed &= not self._learnt
        if self._learnt:
            record = BreathingRecord(now_s, model.breaths, model.held_out_mm, self._latency_s())
            self._log(record)
