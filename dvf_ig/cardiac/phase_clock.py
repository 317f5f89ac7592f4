"""Cardiac phase estimator: phase, its uncertainty and its state from the R peaks up to now."""

import math
from collections import deque

from dvf_ig.core import InvalidInputError, PhaseForecast, PhaseReading, PhaseState

from .rhythm import Rhythm
from .rpeak import RPeak

SAME_BEAT_S = 0.25
"""An R peak within this time of the last one replaces it: a correction by the detector."""
R_TIMING_S = 0.005
"""Standard deviation of the time of a detected R peak."""
LATEST_S = 1e10
"""Latest valid time: seconds since 1970 stay below 1e10 for another 200 years."""


LOCK_BEATS = 5
"""R peaks before the first lock. For the states see docs/theory/cardiac.md."""
RELOCK_BEATS = 4
"""Intervals in a row that must agree with their prediction to end LOST."""
CONSISTENT_SHARE = 0.2
"""An interval within this share of the prediction agrees with it."""
LOST_SHARE = 1.35
"""No R by this multiple of the predicted RR (plus the detection latency) gives LOST."""
LOCK_SPREAD = 0.15
"""LOCKED needs a standard deviation of the predicted RR of at most this share of it."""
MISS_SHARE = 0.15
"""A confident prediction that was off by more than this share was wrong."""
MISSED_SHARE = 0.12
"""LOCKED needs at most this share of recent confident predictions to be wrong."""
RECORD_GAIN = 0.05
"""Gain of the running share of wrong predictions."""
IRREGULAR_SHARE = 0.08
"""A phase that cannot be trusted is IRREGULAR, not SUSPECT, while the median error of the last intervals is
above this."""
REGULAR_SHARE = 0.06
"""IRREGULAR ends when that median has fallen to this."""
MIN_QUALITY = 0.3
"""An R peak of lower quality gives SUSPECT."""
CATCH_UP = 3.0
"""Largest rate of phase, as a multiple of the predicted heart rate."""


class PhaseClock:
    """Causal phase estimator: takes R peaks as they are detected and forecasts phase between them.

    LOCKED only if the forecast of the current beat is confident and such forecasts have recently been
    right; never in a beat that came early. Unwrapped phase (beats + phi) never decreases: it waits for a late
    R and catches up with an early one at a bounded rate. While no R comes it continues past 1 and wraps. The
    predicted RR is updated once a beat. A beat that is overdue changes the state at exactly its deadline,
    whenever the clock is queried, so its phase at a time does not depend on earlier queries.
    """

    def __init__(self) -> None:
        self._rhythm = Rhythm()
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
            catch_up=CATCH_UP,
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
        return known_s + LOST_SHARE * forecast.longest_s, after

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
        if quality < MIN_QUALITY:
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
        expected_s = self._rhythm.forecast.rr_s
        error = abs(interval_s - expected_s) / expected_s
        self._consistent = self._consistent + 1 if error <= CONSISTENT_SHARE else 0
        if self._confident():
            self._missed += RECORD_GAIN * (float(error > MISS_SHARE) - self._missed)

    def _confident(self) -> bool:
        """Return whether the forecast of the current beat is precise enough for phase to be used."""
        forecast = self._rhythm.forecast
        return forecast.spread <= LOCK_SPREAD and not forecast.unreliable

    def _update_state(self) -> None:
        trusted = self._confident() and self._missed <= MISSED_SHARE
        if self._state == PhaseState.INIT and self._beats < LOCK_BEATS:
            return
        limit = REGULAR_SHARE if self._state == PhaseState.IRREGULAR else IRREGULAR_SHARE
        if not trusted and self._rhythm.irregularity > limit:
            self._state = PhaseState.IRREGULAR
        elif self._state != PhaseState.LOST or self._consistent >= RELOCK_BEATS:
            self._state = PhaseState.LOCKED if trusted else PhaseState.SUSPECT

    def _set_lost(self) -> None:
        if self._state != PhaseState.INIT:
            self._state = PhaseState.LOST
        self._consistent = 0


def _require_time(t_s: float) -> None:
    """Refuse a time beyond any clock, after which every valid time would count as too early."""
    if not abs(t_s) <= LATEST_S:
        raise InvalidInputError(f"the phase clock got the time {t_s:g} s; needed at most {LATEST_S:g} s")
