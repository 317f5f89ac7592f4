"""Cardiac phase estimator: phase, its uncertainty and its state from the R peaks up to now."""

import math
from collections import deque
from dataclasses import dataclass, field

from dvf_ig.core import InvalidInputError, PhaseForecast, PhaseReading, PhaseState

from .rhythm import Rhythm, RhythmOptions
from .rpeak import RPeak

SAME_BEAT_S = 0.25
"""An R peak within this time of the last one replaces it: a correction by the detector."""
R_TIMING_S = 0.005
"""Standard deviation of the time of a detected R peak."""
LATEST_S = 1e10
"""Latest valid time: seconds since 1970 stay below 1e10 for another 200 years."""


@dataclass(frozen=True, slots=True)
class PhaseClockOptions:
    """Limits of the states (docs/theory/cardiac.md) and of the rate of phase.

    Attributes:
        rhythm: how intervals are classified and predicted.
        lock_beats: R peaks before the first lock.
        relock_beats: intervals in a row that must agree with their prediction to end LOST.
        consistent_share: an interval within this share of the prediction agrees with it.
        lost_share: no R by this multiple of the predicted RR (plus the detection latency) gives LOST.
        lock_spread: LOCKED needs a standard deviation of the predicted RR of at most this share of it.
        miss_share: a confident prediction that was off by more than this share was wrong.
        missed_share: LOCKED needs at most this share of recent confident predictions to be wrong.
        record_gain: gain of that running share.
        irregular_share: a phase that cannot be trusted is IRREGULAR, not SUSPECT, while the median error of
            the last intervals is above this.
        regular_share: IRREGULAR ends when that median has fallen to this.
        min_quality: an R peak of lower quality gives SUSPECT.
        catch_up: largest rate of phase, as a multiple of the predicted heart rate.
    """

    rhythm: RhythmOptions = field(default_factory=RhythmOptions)
    lock_beats: int = 5
    relock_beats: int = 4
    consistent_share: float = 0.2
    lost_share: float = 1.35
    lock_spread: float = 0.15
    miss_share: float = 0.15
    missed_share: float = 0.12
    record_gain: float = 0.05
    irregular_share: float = 0.08
    regular_share: float = 0.06
    min_quality: float = 0.3
    catch_up: float = 3.0


class PhaseClock:
    """Causal phase estimator: takes R peaks as they are detected and forecasts phase between them.

    LOCKED only if the forecast of the current beat is confident and such forecasts have recently been
    right; never in a beat that came early. Unwrapped phase (beats + phi) never decreases: it waits for a late
    R and catches up with an early one at a bounded rate. While no R comes it continues past 1 and wraps. The
    predicted RR is updated once a beat. A beat that is overdue changes the state at exactly its deadline,
    whenever the clock is queried, so its phase at a time does not depend on earlier queries.
    """

    def __init__(self, options: PhaseClockOptions | None = None) -> None:
        self._options = options or PhaseClockOptions()
        self._rhythm = Rhythm(self._options.rhythm)
        self._state = PhaseState.INIT
        self._last_r_s = math.nan
        self._rr_s = math.nan
        self._beats = 0
        self._consistent = 0  # intervals in a row that agreed with their prediction, since LOST
        self._missed = 0.0  # share of recent confident forecasts that were wrong
        self._latencies: deque[float] = deque(maxlen=9)
        self._latency_s = 0.15
        self._cycles = 0.0  # of the target at the last R, on the count of the forecast's phase
        self._overdue = False  # no R for too long since the last one
        self._continuous = True  # no interruption of the ECG since the last R
        self._forecast = PhaseForecast.unknown()
        self._now_s = -math.inf

    @property
    def state(self) -> PhaseState:
        """State as of the last event."""
        return self._state

    def add(self, peak: RPeak) -> None:
        """Add an R peak that has just been detected.

        Raises:
            InvalidInputError: it lies before the last one, or its times or its quality are not numbers.
        """
        _require_time(peak.t_s)
        _require_time(peak.detected_at_s)
        if not 0.0 <= peak.quality < math.inf:
            raise InvalidInputError(f"an R peak has the quality {peak.quality:g}; needed 0 or more")
        if peak.t_s <= self._last_r_s:
            raise InvalidInputError(
                f"R peak at {peak.t_s:.3f} s came after the one at {self._last_r_s:.3f} s; feed them in order"
            )
        self._advance(peak.detected_at_s)
        if self._beats and peak.t_s - self._last_r_s < SAME_BEAT_S:
            # the detector found the true complex just after a false one: only R is moved
            self._last_r_s = peak.t_s
        else:
            self._add_beat(peak)
        self._update_forecast(self._now_s)

    def signal_changed(self, t_s: float, on: bool) -> None:
        """Record that the ECG was lost (flat, railed or missing for 200 ms) or has returned.

        Raises:
            InvalidInputError: the time is not a number.
        """
        _require_time(t_s)
        self._advance(t_s)
        if not on:
            self._continuous = False
            self._set_lost()
            self._update_forecast(self._now_s)

    def forecast(self, now_s: float) -> PhaseForecast:
        """Forecast phase from `now_s` on, from the peaks known now.

        Raises:
            InvalidInputError: `now_s` is not a number, or lies before an event or an earlier query.
        """
        _require_time(now_s)
        if not now_s >= self._now_s:
            raise InvalidInputError(
                f"phase at {now_s:.4f} s was requested after {self._now_s:.4f} s; needed times in order"
            )
        self._advance(now_s)
        return self._forecast

    def at(self, now_s: float) -> PhaseReading:
        """Return phase now: `forecast(now_s).at(now_s)`."""
        return self.forecast(now_s).at(now_s)

    # ------------------------------------------------------------------ phase

    def _advance(self, t_s: float) -> None:
        """Apply the deadlines that have passed by `t_s`, each at its time."""
        while t_s > self._forecast.until_s:
            deadline_s = self._forecast.until_s
            self._expire()
            self._update_forecast(deadline_s)
        self._now_s = max(self._now_s, t_s)

    def _update_forecast(self, t_s: float) -> None:
        """Continue phase from its value at `t_s`, towards the target known now."""
        reached = float(self._forecast.unwrapped(t_s))
        whole = math.floor(reached)
        phi = reached - whole
        self._cycles -= whole
        if self._state != PhaseState.LOCKED and self._rr_s > 0:
            # only the position in the cycle matters now: advance to it, or wait if that is shorter
            gap = self._cycles + (t_s - self._last_r_s) / self._rr_s - phi
            self._cycles -= math.floor(gap + 0.5)
        until_s, after = self._deadline()
        self._forecast = PhaseForecast(
            since_s=t_s,
            until_s=max(until_s, t_s),
            state=self._state,
            state_after=after,
            phi=phi,
            r_s=self._last_r_s,
            cycles=self._cycles,
            rr_s=self._rr_s,
            spread=self._rhythm.forecast.spread,
            catch_up=self._options.catch_up,
            r_timing_s=R_TIMING_S,
        )

    def _early_expected(self) -> bool:
        forecast = self._rhythm.forecast
        return forecast.early and self._rr_s < forecast.normal_s

    def _deadline(self) -> tuple[float, PhaseState]:
        """Return when the next beat is overdue, and the state from then on."""
        if self._overdue or not (self._beats and self._rr_s > 0):
            return math.inf, PhaseState.LOST
        forecast, known_s = self._rhythm.forecast, self._last_r_s + self._latency_s
        if self._early_expected():
            after = PhaseState.SUSPECT if self._state == PhaseState.LOCKED else self._state
            return known_s + (1.0 + 2.0 * forecast.spread) * self._rr_s, after
        after = self._state if self._state == PhaseState.INIT else PhaseState.LOST
        return known_s + self._options.lost_share * forecast.longest_s, after

    def _expire(self) -> None:
        """Handle an expected early beat that did not come, or a time too long without R."""
        if not self._early_expected():
            self._overdue = True
            self._set_lost()
            return
        self._rr_s = self._rhythm.forecast.normal_s
        if self._state == PhaseState.LOCKED:
            self._state = PhaseState.SUSPECT

    # ------------------------------------------------------------------ state

    def _add_beat(self, peak: RPeak) -> None:
        """Begin a new beat."""
        self._latencies.append(peak.detected_at_s - peak.t_s)
        self._latency_s = sorted(self._latencies)[len(self._latencies) // 2]
        interval_s = peak.t_s - self._last_r_s
        self._last_r_s = peak.t_s
        self._beats += 1
        self._cycles += 1.0
        self._overdue = False
        if self._beats > 1 and self._continuous:
            self._assess(interval_s, peak.quality)
        self._continuous = True

    def _assess(self, interval_s: float, quality: float) -> None:
        """Update prediction and state with a finished interval."""
        if quality < self._options.min_quality:
            self._consistent = 0
            if self._state == PhaseState.LOCKED:
                self._state = PhaseState.SUSPECT
            return
        self._score_forecast(interval_s)
        self._rhythm.add(interval_s)
        self._rr_s = self._rhythm.forecast.rr_s
        self._update_state()

    def _score_forecast(self, interval_s: float) -> None:
        """Update how many intervals agreed with their forecast, and how many confident forecasts failed."""
        options, expected_s = self._options, self._rhythm.forecast.rr_s
        error = abs(interval_s - expected_s) / expected_s
        self._consistent = self._consistent + 1 if error <= options.consistent_share else 0
        if self._confident():
            self._missed += options.record_gain * (float(error > options.miss_share) - self._missed)

    def _confident(self) -> bool:
        """Return whether the forecast of the current beat is precise enough for phase to be used."""
        forecast = self._rhythm.forecast
        return forecast.spread <= self._options.lock_spread and not forecast.unreliable

    def _update_state(self) -> None:
        options = self._options
        trusted = self._confident() and self._missed <= options.missed_share
        if self._state == PhaseState.INIT and self._beats < options.lock_beats:
            return
        limit = options.regular_share if self._state == PhaseState.IRREGULAR else options.irregular_share
        if not trusted and self._rhythm.irregularity > limit:
            self._state = PhaseState.IRREGULAR
        elif self._state != PhaseState.LOST or self._consistent >= options.relock_beats:
            self._state = PhaseState.LOCKED if trusted else PhaseState.SUSPECT

    def _set_lost(self) -> None:
        if self._state != PhaseState.INIT:
            self._state = PhaseState.LOST
        self._consistent = 0


def _require_time(t_s: float) -> None:
    """Refuse a time beyond any clock, after which every valid time would count as too early."""
    if not abs(t_s) <= LATEST_S:
        raise InvalidInputError(f"the phase clock got the time {t_s:g} s; needed at most {LATEST_S:g} s")
