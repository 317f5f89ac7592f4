"""The heart's clock: phase, its uncertainty and its state at any time, from the R peaks known so far."""

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from dvf_ig.core import InvalidInputError, PhaseState

from .rhythm import Rhythm, RhythmOptions
from .rpeak import RPeak

SAME_BEAT_S = 0.25
"""An R peak this soon after the last one replaces it: the detector has corrected itself."""
R_TIMING_S = 0.005
"""One standard deviation of the time of a detected R peak."""


@dataclass(frozen=True, slots=True)
class PhaseClockOptions:
    """Limits of the states (dvf_ig/docs/theory/cardiac.md) and how fast phase may catch up.

    Attributes:
        rhythm: how intervals are judged and predicted.
        lock_beats: R peaks before the first lock.
        relock_beats: intervals in a row that must come as predicted to end LOST.
        consistent_share: an interval within this share of the prediction came as predicted.
        lost_share: no R by this multiple of the predicted RR (and the detection latency) makes it LOST.
        lock_spread: LOCKED needs one standard deviation of the predicted RR to be within this share of it.
        miss_share: a prediction that would have been trusted was a miss when it was off by more than this.
        missed_share: LOCKED needs at most this share of recent trusted predictions to be misses.
        record_gain: weight of the latest trusted prediction in that share.
        irregular_share: not to be trusted is called IRREGULAR, not SUSPECT, while half of the last intervals
            were off by more than this.
        regular_share: IRREGULAR ends when that median has fallen to this.
        min_quality: an R of lower quality makes the clock SUSPECT.
        catch_up: phase may advance at most this many times as fast as the heart's predicted rate.
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


class PhaseReading(NamedTuple):
    """Phase in [0, 1), one standard deviation of it, predicted length of the running beat, state."""

    phi: float
    sigma_phi: float
    rr_s: float
    state: PhaseState


class PhaseClock:
    """Feed R peaks with `add` when they become known and ask with `at`, both in order of time.

    LOCKED only where the forecast of the running beat is certain and such forecasts have held lately; never
    in a beat that came early. Unwrapped phase (beats + phi) never decreases: a late R holds it, an early one
    is caught up at a bounded rate. While no R is seen it runs on past 1 and wraps. The predicted RR is
    latched at each beat.
    """

    def __init__(self, options: PhaseClockOptions | None = None) -> None:
        self._options = options or PhaseClockOptions()
        self._rhythm = Rhythm(self._options.rhythm)
        self._state = PhaseState.INIT
        self._last_r_s = float("nan")
        self._rr_s = float("nan")
        self._beats = 0
        self._steady = 0  # intervals in a row that came as predicted, since the clock was lost
        self._missed = 0.0  # share of recent certain forecasts that did not hold
        self._latencies: deque[float] = deque(maxlen=9)
        self._latency_s = 0.15
        self._phase = 0.0
        self._turns = 0.0  # whole cycles between the count of beats and unwrapped phase
        self._asked_s = -np.inf
        self._unbroken = True  # the ECG was there since the last R

    @property
    def state(self) -> PhaseState:
        """State as of the last event."""
        return self._state

    def add(self, peak: RPeak) -> None:
        """An R peak that has just become known.

        Raises:
            InvalidInputError: it lies before the last one.
        """
        if peak.t_s <= self._last_r_s:
            raise InvalidInputError(
                f"R peak at {peak.t_s:.3f} s came after the one at {self._last_r_s:.3f} s; feed them in order"
            )
        self._advance(peak.detected_at_s)
        if self._beats and peak.t_s - self._last_r_s < SAME_BEAT_S:
            # the detector found the true complex just after a false one: move R, undo nothing else
            self._last_r_s = peak.t_s
            return
        self._latencies.append(peak.detected_at_s - peak.t_s)
        self._latency_s = sorted(self._latencies)[len(self._latencies) // 2]
        interval_s = peak.t_s - self._last_r_s
        self._last_r_s = peak.t_s
        self._beats += 1
        if self._beats > 1 and self._unbroken:
            self._judge(interval_s, peak.quality)
        self._unbroken = True

    def signal_changed(self, t_s: float, on: bool) -> None:
        """The ECG was lost (flat, railed or missing for 200 ms) or came back."""
        self._advance(t_s)
        if not on:
            self._unbroken = False
            self._lose()

    def at(self, t_s: float) -> PhaseReading:
        """Phase at `t_s` as known now.

        Raises:
            InvalidInputError: `t_s` lies before an earlier question.
        """
        if t_s < self._asked_s:
            raise InvalidInputError(
                f"phase at {t_s:.4f} s was asked for after {self._asked_s:.4f} s; ask in order of time"
            )
        self._advance(t_s)
        return PhaseReading(float(self._phase % 1.0), self._sigma(t_s), self._rr_s, self._state)

    # ------------------------------------------------------------------ phase

    def _target(self, t_s: float) -> float:
        """Unwrapped phase that the R peaks known now imply: whole beats plus time over predicted RR."""
        if not self._rr_s > 0:
            return self._beats - 1.0 if self._beats else 0.0
        return self._beats - 1.0 + (t_s - self._last_r_s) / self._rr_s

    def _advance(self, t_s: float) -> None:
        """Move phase to `t_s`: towards the target, never backwards, at most at the catch-up rate."""
        if t_s <= self._asked_s:
            return
        self._notice_absence(t_s)
        gap = self._target(t_s) + self._turns - self._phase
        if self._state != PhaseState.LOCKED:
            # only the place in the cycle counts now: run there forwards, or wait where that is shorter
            whole = float(np.floor(gap + 0.5))
            self._turns -= whole
            gap -= whole
        if gap > 0 and self._rr_s > 0:
            reach = self._options.catch_up * (t_s - self._asked_s) / self._rr_s
            self._phase += min(gap, reach)
        self._asked_s = t_s

    def _notice_absence(self, t_s: float) -> None:
        """An expected early beat that has not come, or no R at all for too long."""
        if not (self._beats and self._rr_s > 0):
            return
        forecast, waited_s = self._rhythm.forecast, t_s - self._last_r_s - self._latency_s
        if forecast.early and self._rr_s < forecast.usual_s:
            if waited_s > (1.0 + 2.0 * forecast.spread) * self._rr_s:
                self._rr_s = forecast.usual_s
                if self._state == PhaseState.LOCKED:
                    self._state = PhaseState.SUSPECT
        elif waited_s > self._options.lost_share * forecast.longest_s:
            self._lose()

    def _sigma(self, t_s: float) -> float:
        """One standard deviation: RR prediction error grown with the beat, R timing, what is to catch up."""
        if not self._rr_s > 0:
            return float("nan")
        share = max(0.0, t_s - self._last_r_s) / self._rr_s
        timing = R_TIMING_S / self._rr_s
        behind = self._target(t_s) + self._turns - self._phase
        return float(np.sqrt((self._rhythm.forecast.spread * share) ** 2 + timing**2 + behind**2))

    # ------------------------------------------------------------------ state

    def _judge(self, interval_s: float, quality: float) -> None:
        """Update prediction and state with a finished interval."""
        if quality < self._options.min_quality:
            self._steady = 0
            if self._state == PhaseState.LOCKED:
                self._state = PhaseState.SUSPECT
            return
        self._keep_record(interval_s)
        self._rhythm.add(interval_s)
        self._rr_s = self._rhythm.forecast.rr_s
        self._settle()

    def _keep_record(self, interval_s: float) -> None:
        """How well forecasts held, above all those that looked certain."""
        options, expected_s = self._options, self._rhythm.forecast.rr_s
        off = abs(interval_s - expected_s) / expected_s
        self._steady = self._steady + 1 if off <= options.consistent_share else 0
        if self._certain():
            self._missed += options.record_gain * (float(off > options.miss_share) - self._missed)

    def _certain(self) -> bool:
        """The forecast of the running beat says of itself that phase may be used."""
        forecast = self._rhythm.forecast
        return forecast.spread <= self._options.lock_spread and not forecast.unsettled

    def _settle(self) -> None:
        options = self._options
        trusted = self._certain() and self._missed <= options.missed_share
        if self._state == PhaseState.INIT and self._beats < options.lock_beats:
            return
        limit = options.regular_share if self._state == PhaseState.IRREGULAR else options.irregular_share
        if not trusted and self._rhythm.irregularity > limit:
            self._state = PhaseState.IRREGULAR
        elif self._state != PhaseState.LOST or self._steady >= options.relock_beats:
            self._state = PhaseState.LOCKED if trusted else PhaseState.SUSPECT

    def _lose(self) -> None:
        if self._state != PhaseState.INIT:
            self._state = PhaseState.LOST
        self._steady = 0
