"""The heart's clock: phase, its uncertainty and its state at any time, from the R peaks known so far."""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dvf_ig.core import InvalidInputError, PhaseState

from .rpeak import RPeak
from .rr_predictor import PredictorName, make_predictor

SAME_BEAT_S = 0.25
"""An R peak this soon after the last one replaces it: the detector has corrected itself."""


@dataclass(frozen=True, slots=True)
class PhaseClockOptions:
    """Limits of the states (theory: cardiac) and how fast phase may catch up.

    Attributes:
        predictor: how the next RR interval is predicted.
        lock_beats: R peaks before the first lock.
        relock_beats: consistent intervals in a row that end SUSPECT, LOST and IRREGULAR.
        consistent_share: an interval within this share of the prediction is consistent.
        early_share: an R earlier than this share of the predicted RR makes the clock SUSPECT.
        lost_share: no R by this multiple of the predicted RR (and the detection latency) makes it LOST.
        irregular_cv: coefficient of variation of the last `irregular_beats` intervals that is IRREGULAR.
        irregular_beats: see above.
        min_quality: an R of lower quality makes the clock SUSPECT.
        catch_up: phase may advance at most this many times as fast as the heart's predicted rate.
    """

    predictor: PredictorName = "ar8"
    lock_beats: int = 5
    relock_beats: int = 4
    consistent_share: float = 0.2
    early_share: float = 0.8
    lost_share: float = 1.35
    irregular_cv: float = 0.15
    irregular_beats: int = 16
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

    Unwrapped phase (beats + phi) never decreases: a late R holds it, an early one is caught up at a bounded
    rate. While no R is seen it runs on past 1 and wraps. The predicted RR is latched at each beat.
    """

    def __init__(self, options: PhaseClockOptions | None = None) -> None:
        self._options = options or PhaseClockOptions()
        self._predictor = make_predictor(self._options.predictor)
        self._state = PhaseState.INIT
        self._last_r_s = float("nan")
        self._previous_r_s = float("nan")
        self._rr_s = float("nan")
        self._beats = 0
        self._intervals: deque[float] = deque(maxlen=self._options.irregular_beats)
        self._sound: deque[float] = deque(maxlen=self._options.relock_beats)
        self._consistent = 0
        self._latencies: deque[float] = deque(maxlen=9)
        self._latency_s = 0.15
        self._variance = 0.05**2
        self._phase = 0.0
        self._turns = 0.0  # whole cycles between the count of beats and unwrapped phase
        self._asked_s = -np.inf
        self._signal = True

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
        if self._beats and peak.t_s - self._last_r_s < SAME_BEAT_S:
            self._replace(peak)
            return
        self._advance(peak.detected_at_s)
        self._latencies.append(peak.detected_at_s - peak.t_s)
        self._latency_s = sorted(self._latencies)[len(self._latencies) // 2]
        interval = peak.t_s - self._last_r_s
        self._previous_r_s, self._last_r_s = self._last_r_s, peak.t_s
        self._beats += 1
        self._signal = True
        if self._beats > 1:
            self._judge(interval, peak.quality)
        elif self._state == PhaseState.LOST:
            self._consistent = 0

    def signal_changed(self, t_s: float, on: bool) -> None:
        """The ECG was lost (flat, railed or missing for 200 ms) or came back."""
        self._advance(t_s)
        self._signal = on
        if not on:
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
        overdue = self._options.lost_share * self._rr_s + self._latency_s
        if self._beats and self._rr_s > 0 and t_s - self._last_r_s > overdue:
            self._lose()
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

    def _sigma(self, t_s: float) -> float:
        """One standard deviation: RR prediction error grown with the beat, R timing, what is to catch up."""
        if not self._rr_s > 0:
            return float("nan")
        share = max(0.0, t_s - self._last_r_s) / self._rr_s
        timing = 0.005 / self._rr_s
        behind = self._target(t_s) + self._turns - self._phase
        return float(np.sqrt(self._variance * share**2 + timing**2 + behind**2))

    # ------------------------------------------------------------------ state

    def _judge(self, interval: float, quality: float) -> None:
        """Update prediction, consistency and state with a finished interval."""
        options = self._options
        predicted = self._rr_s
        self._intervals.append(interval)
        self._sound.append(interval)
        known = predicted > 0
        early = known and interval < options.early_share * predicted
        weak = quality < options.min_quality
        if weak:
            self._sound.clear()
        fits = known and abs(interval - predicted) <= options.consistent_share * predicted and not weak
        self._consistent = self._consistent + 1 if fits else 0
        if known and fits:
            error = (interval - predicted) / predicted
            self._variance += 0.1 * (error**2 - self._variance)
        if (early or weak) and self._state == PhaseState.LOCKED:
            self._state = PhaseState.SUSPECT
        elif self._state == PhaseState.INIT or not (early or weak):
            self._follow(interval)
        self._follow_new_rate()
        self._settle()

    def _follow(self, interval: float) -> None:
        self._predictor.add(interval)
        self._rr_s = self._predictor.predict()

    def _follow_new_rate(self) -> None:
        """After a lasting change of rate the recent beats agree with each other, not with the prediction."""
        need = self._options.relock_beats
        recent = list(self._sound)
        if self._state in (PhaseState.LOCKED, PhaseState.INIT) or len(recent) < need or self._consistent:
            return
        middle = float(np.median(recent))
        if max(abs(r - middle) for r in recent) <= self._options.consistent_share * middle:
            self._predictor = make_predictor(self._options.predictor)
            for interval in recent:
                self._follow(interval)
            self._consistent = need

    def _settle(self) -> None:
        options = self._options
        spread = np.array(self._intervals)
        irregular = len(spread) >= options.irregular_beats and (
            float(spread.std(ddof=1)) > options.irregular_cv * float(spread.mean())
        )
        if irregular:
            self._state = PhaseState.IRREGULAR
        elif self._state == PhaseState.INIT:
            if self._beats >= options.lock_beats:
                self._state = PhaseState.LOCKED
        elif self._state != PhaseState.LOCKED and self._consistent >= options.relock_beats:
            self._state = PhaseState.LOCKED

    def _lose(self) -> None:
        if self._state != PhaseState.INIT:
            self._state = PhaseState.LOST
        self._consistent = 0

    def _replace(self, peak: RPeak) -> None:
        """The detector found the true complex just after a false one: move the last R, undo nothing else."""
        self._advance(peak.detected_at_s)
        self._last_r_s = peak.t_s
