"""Breathing in a session: what follows the breath, and from it frames at rest and the pose of the moment.

    followed   a recorded channel or marker; the motion of the heart with it is learnt (`breathing_motion`)
    watched    nothing is recorded: no force until heart beats exclude breathing; where they show it, the ECG
               follows the breath from then on, if it shows the same rate, for force at end-expiration alone

All other parts of a session see the heart at rest, which is end-expiration.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, fields
from math import floor, inf, nan

import numpy as np

from dvf_ig.cardiac import RPeak
from dvf_ig.cardiac.respiration import (
    PARTING,
    BeatClock,
    Breath,
    BreathEvent,
    BreathReading,
    BreathState,
    QrsGain,
    RelearningClock,
    breathing_in_beats,
)
from dvf_ig.cardiac.respiration.beat_clock import MOST_BEATS
from dvf_ig.core import FloatArray, PoseMotion, read_only_arrays
from dvf_ig.registration import (
    MEAN_SQUARE_OF_COORDINATES,
    BeatMeasurement,
    BreathingPose,
    Oscillation,
    OscillationWatch,
)
from dvf_ig.registration.unfollowed_breathing import GONE_MM

from .breathing_motion import AHEAD_S, FollowedBreath, FrameBreathing, LearntMotion
from .clocks import StampOrder
from .events import EcgSamples, RespirationSample
from .reasons import BreathingReason

SAME_RATE_PER_MIN = 2.4
"""Rates of ECG and heart beats differ by no more: two steps of the watch."""
LEAST_EXCURSION_MM = 2.0 * GONE_MM
"""A heart that moves by less with the breath of the ECG does not follow it."""
REST_LEFT_S = 0.2
"""Force on a forecast rest ends so long before it: a breath may come early, or rise faster than others."""
CONFIRMED_S = 0.6
"""Force on a forecast rest begins no later than this after a beat: the next one may show something else."""
UNFOLLOWED_S = 40.0
"""A clock from the ECG that has not been locked for so long is given up."""
UNFOLLOWED = -1
"""State of the clock of breathing if nothing follows the breath; the others are `BreathState`."""


@dataclass(frozen=True, slots=True)
class BreathingRecord:
    """What a session has found about the motion in breathing.

    Attributes:
        from_s: when; the motion that forces follow is learnt again with every breath.
        breaths: number of breaths it was learnt from; None if nothing follows the breath.
        held_out_mm: its error in breaths that it was not learnt from, as in `BreathingPose`.
        latency_s: how far what follows the breath is behind the heart; negative if it is ahead.
        unfollowed_mm, per_minute: motion and rate of breaths that heart beats show, if nothing follows them.
        by_ecg: the ECG follows them.
        breath: the last breaths with the motion; None if forces do not follow it.
    """

    from_s: float
    breaths: int | None = None
    held_out_mm: float | None = None
    latency_s: float | None = None
    unfollowed_mm: float | None = None
    per_minute: float | None = None
    by_ecg: bool = False
    breath: FollowedBreath | None = None

    def described(self) -> dict[str, float | int | bool | None]:
        """Return its numbers by name, as in `result.json`."""
        return {one.name: getattr(self, one.name) for one in fields(self) if one.name != "breath"}


@dataclass(frozen=True, slots=True)
class BreathMoment:
    """Where the heart is in a breath.

    Attributes:
        state: `BreathState` of the clock; UNFOLLOWED if nothing follows the breath.
        phase: as in `BreathReading`; NaN if not known.
        displacement_mm: from rest, of the heart's centre along the main direction of its motion; NaN if not
            known, as before the motion is learnt.
    """

    state: int
    phase: float
    displacement_mm: float


def no_log(_: BreathingRecord) -> None:
    """Log nothing."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BreathingStatus:
    """What holds from one sample of what follows the breath to the next.

    Attributes:
        changed_s: when this and what `BreathingTracker.motion` gives last changed.
        withheld: the pose of the moment is not known: beyond what was learnt, or before it, not at rest.
        covariance_mm2: (6, 6) of the motion from rest; zero without a model in use.
        bound_mm: twice the RMS error of that motion over the heart.
        reason: why the pose is withheld or serves at rest alone, as a sentence; None if it does neither.
        breath: where the heart is in the breath, as of the latest sample.
    """

    changed_s: float
    withheld: bool
    covariance_mm2: FloatArray
    bound_mm: float
    reason: str | None
    breath: BreathMoment = BreathMoment(UNFOLLOWED, nan, nan)


class BreathingTracker:
    """What follows the breath, the learning and the motion.

    Args:
        center_mm: (3,) centre of the heart, model frame.
        log: called with what is found.
        ecg_rate_hz: sampling rate of the ECG; None if there is none.
    """

    def __init__(
        self,
        center_mm: FloatArray,
        log: Callable[[BreathingRecord], None] = no_log,
        ecg_rate_hz: float | None = None,
    ) -> None:
        self.order = StampOrder()
        self._log = log
        self._center_mm = center_mm
        self._recorded = RelearningClock()
        self._changes = 0
        self._waiting: deque[RespirationSample] = deque()
        self._from_ecg: BeatClock | None = None
        self._locked_s = -inf
        self._qrs = None if ecg_rate_hz is None else QrsGain(ecg_rate_hz)
        self._beats: deque[tuple[float, FloatArray]] = deque(maxlen=MOST_BEATS)
        self._changed = False  # for good, and not learnt again yet
        self._motion = LearntMotion(center_mm, self._recorded.clock)
        self._watch = OscillationWatch(center_mm)
        self._watch_changed_s = -inf
        self._known = BreathingStatus(nan, False, np.zeros((6, 6)), 0.0, None)

    # ------------------------------------------------------------------ what follows the breath

    @property
    def _clock(self) -> Breath:
        return self._recorded.clock if self._from_ecg is None else self._from_ecg

    @property
    def follows(self) -> bool:
        """Whether anything follows the breath."""
        return self.order.newest_s > -inf or self._from_ecg is not None

    @property
    def watches(self) -> bool:
        """Whether beats have yet to exclude breathing, which nothing follows."""
        return not self.follows and not self._watch.excluded

    def push(self, sample: RespirationSample) -> bool:
        """Add a sample; False if its stamp is not later than those before."""
        if not self.order.accepts(sample.t_s):
            return False
        if self._from_ecg is not None:
            self._from_ecg = None
            self._begin()
        self._waiting.append(sample)
        return True

    def push_ecg(self, event: EcgSamples) -> None:
        """Add samples of the ECG."""
        if self._qrs is not None:
            self._qrs.push(event.samples, event.start_s)

    def add_peak(self, peak: RPeak) -> bool:
        """Add an R peak when it is detected; whether the ECG follows the breath from then on."""
        if self._qrs is None or (self._beats and peak.t_s <= self._beats[-1][0]):
            return False
        rr_s = peak.t_s - self._beats[-1][0] if self._beats else nan
        values = np.append(self._qrs.gains(peak.t_s, peak.detected_at_s), rr_s)
        self._beats.append((peak.t_s, values))
        if self._from_ecg is not None:
            self._from_ecg.add(peak.t_s, values)
            return False
        motion = None if self.follows else self._watch.found
        return motion is not None and self._follow_ecg(motion, peak.detected_at_s)

    def _follow_ecg(self, motion: Oscillation, now_s: float) -> bool:
        """Let the ECG follow the breath if it shows that rate; whether it does."""
        beats = [beat for beat in self._beats if np.isfinite(beat[1]).all()]
        t_s, values = np.array([t_s for t_s, _ in beats]), np.array([values for _, values in beats])
        shown = breathing_in_beats(t_s, values) if beats else None
        if shown is None or abs(60.0 / shown.fitted.period_s - motion.per_minute) > SAME_RATE_PER_MIN:
            return False
        self._from_ecg, self._locked_s = BeatClock(t_s, values, shown), now_s
        self._begin()
        self._log_unfollowed(now_s, motion, by_ecg=True)
        return True

    def _log_unfollowed(self, from_s: float, motion: Oscillation, *, by_ecg: bool = False) -> None:
        moved_mm, rate = 2.0 * motion.amplitude_mm, motion.per_minute
        self._log(BreathingRecord(from_s, unfollowed_mm=moved_mm, per_minute=rate, by_ecg=by_ecg))

    def _begin(self) -> None:
        """Begin to learn with the clock of now."""
        self._motion = LearntMotion(self._center_mm, self._clock)

    def watch(
        self, middle_s: float, decided_s: float, measurement: BeatMeasurement, view_mm: FloatArray
    ) -> None:
        """Look for breathing in the poses of beats if nothing follows the breath; see `OscillationWatch`."""
        if self.follows:
            return
        watch = self._watch
        before = (watch.found is None, watch.excluded, watch.compared > 0)
        watch.add(middle_s, measurement, view_mm)
        motion = watch.found
        if before == (motion is None, watch.excluded, True):
            return
        self._watch_changed_s = decided_s
        if motion is not None and before[0]:
            self._log_unfollowed(decided_s, motion)

    def shifted(self, from_s: float) -> None:
        """Watch for breathing from then on at another place of the heart."""
        self._watch.shifted(from_s)

    def advance(self, now_s: float) -> bool:
        """Follow the breath until now; whether forces begin to follow the motion."""
        before = self.model
        self.order.advance(now_s)
        if self._qrs is not None:
            self._qrs.forget(now_s)
        while self._waiting and self._waiting[0].t_s <= now_s:
            sample = self._waiting.popleft()
            self._recorded.push(np.array([sample.t_s]), sample.values[None])
        if self._recorded.changes > self._changes:
            self._changes = self._recorded.changes
            self._begin()
            self._changed = True
        if self._from_ecg is not None:
            self._give_up(self._from_ecg, now_s)
        if self.follows and self._motion.advance(now_s):
            self._log_motion(now_s)
        if self._motion.astray:
            self._begin()
            self._changed = True
        return before is None and self.model is not None

    def _give_up(self, clock: BeatClock, now_s: float) -> None:
        """Watch again once the ECG shows no breath for UNFOLLOWED_S, or the heart does not follow it."""
        if clock.reading(now_s).state is BreathState.LOCKED:
            self._locked_s = now_s
        excursion_mm = self._motion.excursion_mm
        still = excursion_mm is not None and excursion_mm < LEAST_EXCURSION_MM
        if still or now_s > self._locked_s + UNFOLLOWED_S:
            self._from_ecg, self._watch = None, OscillationWatch(self._center_mm)
            self._watch_changed_s = now_s
            self._begin()

    def _log_motion(self, now_s: float) -> None:
        model = self._motion.model
        if model is not None:
            self._changed = False
            motion = self._motion
            breath = motion.usual_breath()
            self._log(
                BreathingRecord(now_s, model.breaths, model.held_out_mm, motion.latency_s, breath=breath)
            )

    # ------------------------------------------------------------------ what holds now

    @property
    def model(self) -> BreathingPose | None:
        """The model that forces follow; None before it is learnt."""
        return self._motion.model

    def reading(self, now_s: float) -> BreathReading:
        """Read the clock."""
        return self._clock.reading(now_s)

    def frames(self, event_s: FloatArray) -> FrameBreathing | None:
        """Return breathing at the moments of frames; None if nothing follows the breath."""
        return self._motion.frames(event_s) if self.follows else None

    def add_beat(self, measurement: BeatMeasurement, frames: FrameBreathing) -> None:
        """Learn from a beat; see `LearntMotion.add_beat`."""
        self._motion.add_beat(measurement, frames)

    def motion(self, resting: PoseMotion, now_s: float) -> PoseMotion:
        """Return the pose of the moment, with its rate, from that of the resting heart."""
        return self._motion.motion(resting, now_s)

    def status(self, now_s: float) -> BreathingStatus:
        """Return what holds since the latest sample, computed once."""
        changed_s = self._changed_s(now_s)
        if changed_s != self._known.changed_s:
            evaluate = self._followed if self.follows else self._unfollowed
            self._known = evaluate(changed_s, now_s)
        return self._known

    def withheld(self, now_s: float) -> bool:
        """Whether the pose of the moment is not known."""
        return self.status(now_s).withheld

    def _changed_s(self, now_s: float) -> float:
        """Return when what `motion` and `status` give last changed.

        That is the latest sample, the end of each motion that is published without another one, or the loss;
        if nothing follows the breath, when beats began or ceased to show it.
        """
        if not self.follows:
            return self._watch_changed_s
        latest_s, lost_s = self._clock.latest_s, self._clock.lost_s
        silent_s = now_s - latest_s
        if not silent_s >= AHEAD_S:
            return latest_s
        if silent_s > lost_s:
            return latest_s + lost_s
        return latest_s + min(AHEAD_S * floor(silent_s / AHEAD_S), lost_s - AHEAD_S)

    def _followed(self, changed_s: float, now_s: float) -> BreathingStatus:
        motion, reading = self._motion, self._clock.reading(now_s)
        times = [now_s] if self._clock.continuous else [now_s, now_s + REST_LEFT_S]
        features = motion.features(np.array(times))
        unknown = _unknown(reading, bool(np.isfinite(features).all()))
        if unknown is not None:
            breath = BreathMoment(reading.state, reading.phase, nan)
            return BreathingStatus(changed_s, True, np.zeros((6, 6)), 0.0, unknown, breath)
        breath = BreathMoment(reading.state, reading.phase, motion.displacement_mm(features[0]))
        covariance = motion.covariance_mm2(features[0], reading.sigma_rho)
        bound_mm = float(2.0 * np.sqrt(MEAN_SQUARE_OF_COORDINATES @ np.diag(covariance)))
        if motion.model is not None:
            withheld = not motion.model.knows(features)[0]
            cause = BreathingReason.NOT_LEARNT if withheld else None
        else:
            withheld = not motion.rests(features).all() or self._unconfirmed(now_s)
            cause = self._gated_by
        reason = None if cause is None else cause.value
        return BreathingStatus(changed_s, withheld, covariance, bound_mm, reason, breath)

    def _unconfirmed(self, now_s: float) -> bool:
        """Return whether a rest began by its forecast alone, too long after the last beat."""
        beat_s = self._clock.latest_s
        if self._clock.continuous or now_s <= beat_s + CONFIRMED_S:
            return False
        times = np.arange(beat_s + CONFIRMED_S, now_s, 0.05)
        return not self._motion.rests(self._motion.features(times)).all()

    @property
    def _gated_by(self) -> BreathingReason:
        """Why forces are given at end-expiration alone."""
        if not self._clock.continuous:
            return BreathingReason.BY_ECG
        return BreathingReason.CHANGED if self._changed else BreathingReason.LEARNING

    def _unfollowed(self, changed_s: float, _: float) -> BreathingStatus:
        motion, reason = self._watch.found, None
        if motion is not None:
            template = BreathingReason.NOT_FOLLOWED.value
            reason = template.format(mm=2.0 * motion.amplitude_mm, per_minute=motion.per_minute)
        elif not self._watch.excluded and self._watch.compared:
            reason = BreathingReason.NOT_EXCLUDED.value
        return BreathingStatus(changed_s, not self._watch.excluded, np.zeros((6, 6)), 0.0, reason)


def _unknown(reading: BreathReading, tells: bool) -> str | None:
    """Return why the clock does not tell where the heart is, as a sentence; None if it does."""
    if reading.state is BreathState.INIT:
        return BreathingReason.NO_BREATH.value
    if reading.state is BreathState.LOST:
        return BreathingReason.LOST.value
    if reading.event not in (*PARTING, BreathEvent.UNEXPECTED) and tells:
        return None
    event = BreathEvent.DISCONNECTION if reading.event is BreathEvent.NONE else reading.event
    return BreathingReason.NOT_ORDINARY.value.format(what=event.name.lower().replace("_", " "))
