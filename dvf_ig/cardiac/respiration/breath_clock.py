"""Breathing clock: ρ, phase, state and forecast from the samples up to now."""

import math
from collections import deque
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, InvalidInputError, read_only_arrays

from .surrogate import HIGH, LOW, SurrogateScale, learn_scale

STEP_S = 0.1
HORIZONS = 5
"""Forecasts reach HORIZONS · STEP_S ahead."""
LAGS = np.array([0, 1, 2, 3, 5, 8, 12, 18, 26])
FIT_S = 60.0
LEAST_S = 12.0
"""Shorter histories are held at their last value."""
PRIOR = 0.05
"""SD of the noise of ρ that the ridge assumes; weights have a prior SD of 1."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """Linear predictor of the change of ρ.

    Attributes:
        weights: (HORIZONS, lags) of the differences ρ(t − lag) − ρ(t).
        sigma: (HORIZONS,) RMS of what a fit to the first three quarters missed in the last.
    """

    weights: FloatArray
    sigma: FloatArray

    def at(self, recent: FloatArray, ahead_s: float) -> tuple[float, float]:
        """Compute ρ and its standard deviation `ahead_s` after the last of `recent`.

        Args:
            recent: ρ at 0, STEP_S, 2·STEP_S, … before now, the latest first; max(LAGS) + 1 of them.
        """
        x = recent[LAGS] - recent[0]
        step = min(max(ahead_s / STEP_S, 0.0), float(HORIZONS))
        grid = np.arange(HORIZONS + 1.0)
        change = np.interp(step, grid, np.concatenate([[0.0], self.weights @ x]))
        return float(recent[0] + change), float(np.interp(step, grid, np.concatenate([[0.0], self.sigma])))


def hold(spread: float) -> Forecast:
    """Return the predictor that holds the last value; `spread` is the SD of ρ over a breath."""
    sigma = spread * np.sqrt(2.0) * np.minimum(1.0, np.arange(1, HORIZONS + 1) * STEP_S)
    return Forecast(np.zeros((HORIZONS, len(LAGS))), sigma)


def fit_forecast(rho: FloatArray) -> Forecast:
    """Fit to (n,) ρ every STEP_S, the oldest first."""
    rho = rho[-round(FIT_S / STEP_S) :]
    first, last = int(LAGS[-1]), len(rho) - HORIZONS
    if last - first < round(LEAST_S / STEP_S):
        return hold(float(np.std(rho)) if len(rho) else 1.0)
    now = np.arange(first, last)
    x = rho[now[:, None] - LAGS] - rho[now][:, None]
    y = np.stack([rho[now + k] - rho[now] for k in range(1, HORIZONS + 1)], axis=1)
    checked = len(x) // 4
    missed = y[-checked:] - x[-checked:] @ _weights(x[:-checked], y[:-checked])
    return Forecast(_weights(x, y).T, np.sqrt((missed**2).mean(axis=0)))


def _weights(x: FloatArray, y: FloatArray) -> FloatArray:
    normal = x.T @ x / PRIOR**2 + np.eye(len(LAGS))
    return np.asarray(np.linalg.solve(normal, x.T @ y / PRIOR**2))


LAG_S = (0.3, 0.7)
"""First-order lags of ρ that stand for the hysteresis of the heart's motion (docs/theory/respiration.md)."""
SMOOTH_S = 0.04
RATE_S = 0.1
"""Time constants against the noise of ρ, and of its rate."""
KEEP_S = 240.0
RANGE_S = 15.0
"""Time over which the range of breaths is followed to find where they begin, whatever the baseline does."""
ARM, BEGIN = 0.3, 0.5
"""Shares of that range of L₀.₃ρ, free of the heartbeat in a channel: a breath begins at the second, once it
was below the first."""
BEFORE_S = 0.5
"""Samples this long before an event of PARTING was noticed may already belong to it."""


class BreathState(IntEnum):
    """State of the breathing clock; only with LOCKED may a pose be forecast."""

    INIT = 0
    LOCKED = 1
    IRREGULAR = 2
    LOST = 3


class BreathEvent(IntEnum):
    """What breathing did last that an ordinary breath does not."""

    NONE = 0
    DEEP_BREATH = 1
    COUGH = 2
    PAUSE = 3
    CHANGED_RATE = 4
    DISCONNECTION = 5
    UNEXPECTED = 6


PARTING = (BreathEvent.DEEP_BREATH, BreathEvent.COUGH, BreathEvent.DISCONNECTION)
"""Events in which the heart may be elsewhere than what follows the breath tells."""


LEARN_S = 10.0
"""Time from which the scale of ρ is learnt."""
LOCK_BREATHS = 2
"""Ordinary breaths before LOCKED, at first and after an event."""
TOP = 1.5
BOTTOM = -0.35
"""A breath is ordinary if ρ stays between these."""
LATE_SHARE = 1.7
"""No breath by this multiple of the period is a pause."""
PERIODS = (0.6, 1.6)
"""Shortest and longest breath as a share of the usual one."""
FAST = 2.5
"""Rate of ρ above this multiple of the usual largest is a cough."""
LOST_S = 0.5
"""Without a sample for this long the state is LOST."""


@dataclass(frozen=True, slots=True)
class BreathReading:
    """Breathing at a time.

    Attributes:
        rho, sigma_rho: 0 at end-expiration and 1 at the usual top, and its standard deviation; NaN in INIT.
        phase: share of the usual breath since this one began, below 1.
        period_s: usual length of a breath; NaN before the first two.
        state, event: see their classes; the event is that which ended LOCKED, or the first of PARTING since.
    """

    rho: float
    sigma_rho: float
    phase: float
    period_s: float
    state: BreathState
    event: BreathEvent


class Breath(Protocol):
    """A breathing clock, see `BreathClock`."""

    @property
    def continuous(self) -> bool:
        """Whether it is sampled so often that a departure from the ordinary is noticed at once."""

    @property
    def latest_s(self) -> float: ...

    @property
    def lost_s(self) -> float: ...

    @property
    def onsets_s(self) -> tuple[float, ...]: ...

    def reading(self, t_s: float) -> BreathReading: ...

    def features(self, t_s: FloatArray) -> FloatArray: ...

    def tells(self, t_s: FloatArray) -> BoolArray: ...

    def rest_level(self, share: float) -> float: ...

    def rest_features(self, share: float) -> FloatArray: ...


class BreathClock:
    """Causal breathing clock: samples in, ρ and its lags out, of the past by memory, ahead by forecast."""

    continuous = True

    def __init__(self) -> None:
        self._scale: SurrogateScale | None = None
        self._waiting: list[tuple[float, FloatArray]] = []
        self._table = np.empty((1024, 5))  # time, ρ, its two lags, 1 where they do not tell the heart's place
        self._count = 0
        self._rate = 0.0
        self._rates: deque[float] = deque(maxlen=8)  # largest of each of the last breaths
        self._fastest = 0.0  # their median
        self._period_s = math.nan  # median length of the last breaths
        self._largest_rate = 0.0
        self._armed = False
        self._range, self._range_until_s = (0.0, 1.0), -math.inf
        self._onsets: deque[float] = deque(maxlen=7)
        self._ordinary = 0  # breaths in a row
        self._event = BreathEvent.NONE
        self._parted = False  # since an event of PARTING, until an ordinary breath
        self._grid: deque[float] = deque(maxlen=700)  # ρ every STEP_S
        self._grid_s = math.nan
        self._forecast: Forecast = hold(1.0)

    @property
    def latest_s(self) -> float:
        """Time of the latest sample; NaN before the first."""
        if self._count:
            return float(self._table[self._count - 1, 0])
        return self._waiting[-1][0] if self._waiting else math.nan

    @property
    def lost_s(self) -> float:
        """Time without a sample after which breathing is lost."""
        return LOST_S

    @property
    def onsets_s(self) -> tuple[float, ...]:
        """Beginnings of the last breaths."""
        return tuple(self._onsets)

    @property
    def ordinary_breaths(self) -> int:
        """Number of ordinary breaths in a row."""
        return self._ordinary

    @property
    def astray(self) -> bool:
        """Whether an event of PARTING ended LOCKED, and too few ordinary breaths have followed it."""
        return self._event in PARTING and self._ordinary < LOCK_BREATHS

    def push(self, t_s: FloatArray, values: FloatArray) -> None:
        """Add samples (n,), (n, columns).

        Raises:
            InvalidInputError: not finite, or not later than what was added.
        """
        times = np.asarray(t_s, dtype=np.float64)
        if not (np.isfinite(times).all() and np.isfinite(values).all()):
            raise InvalidInputError("a sample of breathing is not finite; leave gaps out")
        for at_s, value in zip(times.tolist(), np.asarray(values, dtype=np.float64), strict=True):
            if at_s <= self.latest_s:
                raise InvalidInputError(
                    f"a sample of breathing at {at_s:.3f} s came after {self.latest_s:.3f} s"
                )
            if self._scale is None:
                self._learn(at_s, value)
            else:
                self._add(at_s, float(self._scale.rho(value[None])[0]))

    def reading(self, t_s: float) -> BreathReading:
        """Read the clock at a time: the latest sample's, or forecast after it."""
        if not self._count:
            state = BreathState.INIT
            return BreathReading(math.nan, math.nan, math.nan, math.nan, state, BreathEvent.NONE)
        rho, sigma = self._ahead(t_s - self.latest_s)
        begin_s, period_s = self._onsets[-1] if self._onsets else math.nan, self._period_s
        phase = min((t_s - begin_s) / period_s, math.nextafter(1.0, 0.0)) if period_s > 0 else math.nan
        state, event = self._state_at(t_s)
        return BreathReading(rho, sigma, phase, period_s, state, event)

    def features(self, t_s: FloatArray) -> FloatArray:
        """Compute (n, 4) rows [1, ρ, L₀.₃ρ, L₀.₇ρ]; NaN before the first sample and beyond the forecast."""
        times = np.atleast_1d(np.asarray(t_s, dtype=np.float64))
        out = np.full((len(times), 4), np.nan)
        if not self._count:
            return out
        table = self._table[: self._count]
        inside = (times >= table[0, 0]) & (times <= table[-1, 0])
        out[inside, 0] = 1.0
        for k in (1, 2, 3):
            out[inside, k] = np.interp(times[inside], table[:, 0], table[:, k])
        later = (times > table[-1, 0]) & (times <= table[-1, 0] + HORIZONS * STEP_S)
        for i in np.flatnonzero(later).tolist():
            ahead_s = float(times[i] - table[-1, 0])
            rho = self._ahead(ahead_s)[0]
            mean = 0.5 * (rho + table[-1, 1])
            shares = [1.0 - math.exp(-ahead_s / tau) for tau in LAG_S]
            lags = [old + share * (mean - old) for old, share in zip(table[-1, 2:4], shares, strict=True)]
            out[i] = (1.0, rho, *lags)
        return out

    def tells(self, t_s: FloatArray) -> BoolArray:
        """Return whether `features` at (n,) times tell where the heart is.

        They do not in gaps of the samples, and from an event of PARTING until an ordinary breath followed it.
        """
        table = self._table[: self._count]
        return np.asarray(np.interp(t_s, table[:, 0], table[:, 4]) == 0.0)

    def rest_level(self, share: float) -> float:
        """Return the level below which ρ and both of its lags were for `share` of the remembered time.

        The lags keep out the beginning of expiration, when an airway pressure is low but the heart still
        moves. NaN in INIT.
        """
        if not self._count:
            return math.nan
        return float(np.quantile(self._usual_rows().max(axis=1), share))

    def rest_features(self, share: float) -> FloatArray:
        """Return the mean (4,) row of `features` below that level."""
        rows = self._usual_rows()
        low = rows[rows.max(axis=1) <= self.rest_level(share)]
        return np.concatenate([[1.0], low.mean(axis=0)])

    def _usual_rows(self) -> FloatArray:
        """Return (n, 3) ρ and its lags where they tell where the heart is; all of them if they never do."""
        table = self._table[: self._count]
        usual = table[:, 4] == 0.0
        return table[usual, 1:4] if usual.any() else table[:, 1:4]

    def _learn(self, at_s: float, value: FloatArray) -> None:
        """Wait until the scale can be learnt, then take up what was waiting."""
        self._waiting.append((at_s, value))
        if at_s - self._waiting[0][0] < LEARN_S:
            return
        self._scale = learn_scale(np.array([v for _, v in self._waiting]))
        if self._scale is None:
            half = self._waiting[0][0] + 0.5 * LEARN_S
            self._waiting = [(t, v) for t, v in self._waiting if t >= half]
            return
        waiting, self._waiting = self._waiting, []
        for t, v in waiting:
            self._add(t, float(self._scale.rho(v[None])[0]))

    def _add(self, at_s: float, rho: float) -> None:
        if not self._count:
            row = np.array([at_s, rho, rho, rho, 0.0])
        else:
            before = self._table[self._count - 1]
            step_s = at_s - float(before[0])
            smooth = float(before[1]) + (1.0 - math.exp(-step_s / SMOOTH_S)) * (rho - float(before[1]))
            share = 1.0 - math.exp(-step_s / RATE_S)
            self._rate += share * ((smooth - float(before[1])) / step_s - self._rate)
            mean = 0.5 * (smooth + float(before[1]))
            lags = [
                old + (1.0 - math.exp(-step_s / tau)) * (mean - old)
                for old, tau in zip(before[2:4].tolist(), LAG_S, strict=True)
            ]
            gap = step_s > LOST_S
            before[4] = max(before[4], gap)
            row = np.array([at_s, smooth, *lags, gap])
        self._remember(row)
        self._watch(at_s, float(row[1]))
        self._parted &= self._ordinary == 0
        if self._parted:
            self._table[self._count - 1, 4] = 1.0
        self._extend_grid()

    def _remember(self, row: FloatArray) -> None:
        if self._count == len(self._table):
            table = self._table
            recent = table[table[:, 0] >= row[0] - KEEP_S]
            self._table = np.empty((max(1024, 2 * len(recent)), 5))
            self._table[: len(recent)], self._count = recent, len(recent)
        self._table[self._count] = row
        self._count += 1

    def _watch(self, at_s: float, rho: float) -> None:
        """Find the beginning of breaths, and whether the running one is ordinary."""
        usual = self._fastest
        self._largest_rate = max(self._largest_rate, abs(self._rate))
        if rho > TOP or (rho < BOTTOM and self._count > 5):
            self._break(BreathEvent.DEEP_BREATH if rho > TOP else BreathEvent.DISCONNECTION)
        elif usual > 0 and abs(self._rate) > FAST * usual:
            self._break(BreathEvent.COUGH)
        low, high = self._recent_range(at_s)
        slow = float(self._table[self._count - 1, 2])
        if slow < low + ARM * (high - low):
            self._armed = True
        elif self._armed and slow > low + BEGIN * (high - low):
            self._armed = False
            self._begin(at_s)
        if self._onsets and at_s - self._onsets[-1] > LATE_SHARE * self._period_s:
            self._break(BreathEvent.PAUSE)

    def _recent_range(self, at_s: float) -> tuple[float, float]:
        """Return the range of ordinary ρ in the last RANGE_S, renewed twice a second."""
        if not at_s < self._range_until_s:
            begin = int(np.searchsorted(self._table[: self._count, 0], at_s - RANGE_S))
            recent = self._table[begin : self._count]
            ordinary = (recent[:, 1] > BOTTOM) & (recent[:, 1] < TOP)
            if ordinary.sum() >= 0.1 * len(recent):
                low, high = np.percentile(recent[ordinary, 2], (LOW, HIGH))
                self._range = (float(low), float(high))
            self._range_until_s = at_s + 0.5
        return self._range

    def _begin(self, at_s: float) -> None:
        """Count a breath, if it took about as long as usual, as ordinary."""
        period_s, ordinary = self._period_s, True
        if self._onsets:
            share = (at_s - self._onsets[-1]) / period_s if period_s > 0 else 1.0
            ordinary = PERIODS[0] <= share <= PERIODS[1]
            if not ordinary:
                late = share > LATE_SHARE
                self._break(BreathEvent.PAUSE if late else BreathEvent.CHANGED_RATE)
        self._onsets.append(at_s)
        self._rates.append(self._largest_rate)
        self._largest_rate = 0.0
        if len(self._onsets) > 1:
            self._period_s = float(np.median(np.diff(self._onsets)))
        if len(self._rates) >= 3:
            self._fastest = float(np.median(self._rates))
        if ordinary:
            self._ordinary += 1

    def _break(self, event: BreathEvent) -> None:
        parts = event in PARTING and self._event not in PARTING
        if self._ordinary or self._event is BreathEvent.NONE or parts:
            self._event = event
        if event in PARTING and not self._parted:
            table = self._table[: self._count]
            table[table[:, 0] >= table[-1, 0] - BEFORE_S, 4] = 1.0
            self._parted = True
        self._ordinary = 0

    def _state_at(self, t_s: float) -> tuple[BreathState, BreathEvent]:
        if t_s - self.latest_s > LOST_S:
            return BreathState.LOST, BreathEvent.DISCONNECTION
        if len(self._onsets) < 3:
            return BreathState.INIT, BreathEvent.NONE
        quiet_s = t_s - self._onsets[-1]
        if quiet_s > LATE_SHARE * self._period_s:
            return BreathState.IRREGULAR, self._event or BreathEvent.PAUSE
        if self._ordinary < LOCK_BREATHS:
            return BreathState.IRREGULAR, self._event
        return BreathState.LOCKED, BreathEvent.NONE

    def _extend_grid(self) -> None:
        """Keep ρ on an even grid, and fit the forecast again every second."""
        now_s = float(self._table[self._count - 1, 0])
        if math.isnan(self._grid_s):
            self._grid_s = now_s - STEP_S
        new = np.arange(self._grid_s + STEP_S, now_s + 1e-9, STEP_S)
        if not len(new):
            return
        if len(new) > round(1.0 / STEP_S):
            self._grid.clear()  # a gap
            self._grid_s = now_s - STEP_S
            return
        tail = self._table[max(0, self._count - 400) : self._count]
        for at_s, rho in zip(new.tolist(), np.interp(new, tail[:, 0], tail[:, 1]).tolist(), strict=True):
            self._grid.append(rho)
            self._grid_s = at_s
            if round(at_s / STEP_S) % 10 == 0:
                self._forecast = fit_forecast(np.array(self._grid))

    def _ahead(self, ahead_s: float) -> tuple[float, float]:
        """Forecast ρ and its standard deviation after the latest sample."""
        tail = self._table[max(0, self._count - 2000) : self._count]
        back = tail[-1, 0] - np.arange(LAGS[-1] + 1) * STEP_S
        return self._forecast.at(np.interp(back, tail[:, 0], tail[:, 1]), ahead_s)
