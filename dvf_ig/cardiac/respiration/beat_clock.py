"""Breathing clock from what is known once a heart beat: the size of its QRS complex in each lead, and RR.

Between and after the beats ρ is that of a quasi-periodic process, smoothed over the last REVISED_S and
forecast ahead. Its standard deviation decides whether it tells where the heart is.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from dvf_ig.core import BoolArray, FloatArray, read_only_arrays

from .breath_clock import ARM, BEGIN, LAG_S, BreathEvent, BreathReading, BreathState
from .quasi_periodic import QuasiPeriodic, fit_quasi_periodic, strongest_period_s
from .surrogate import learn_scale

LEAST_BEATS, MOST_BEATS = 18, 45
"""Beats that a clock begins with, and that it remembers."""
WINDOW_S = 32.0
"""Time in which a rate is found; such windows overlap by half."""
LEAST_SPREAD = 0.004
"""Least median distance from the median of QRS gains, and of RR in s: less is noise of ECG and sampling."""
LEAST_GAIN = 10.0
"""Least log-likelihood of breathing above drift and noise."""
STEP_S = 0.05
REVISED_S = 3.0
"""ρ is no longer revised when beats this much later are known."""
AHEAD_S = 2.5
"""ρ is forecast this far after the last beat; then it is lost."""
KEEP_S = 120.0
UNDERSTATED = 1.4
"""RMS of the errors of ρ over the standard deviation of the process, in the breaths of `data_synth`."""
MOST_SIGMA = 0.3
"""Standard deviation of ρ above which it does not tell where the heart is."""
UNEXPECTED = 3.3
"""Standard deviations of one beat, or of the sum of two, beyond which breathing is not as forecast."""
ORDINARY_BREATHS = 2.0
DEPTHS = (0.5, 1.6)
"""Range of ρ in a breath of the usual depth."""
MOST_SPREADS = 5.0
"""Values further from the median than this multiple of the median distance are clipped at first."""
ANOTHER_ORIGIN = 3.0
"""A beat this far from the range of ρ is no sinus beat, and tells nothing of breathing."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BreathInBeats:
    """Breathing as beats show it.

    Attributes:
        direction: (columns,) of the beats' values in which it shows most.
        fitted: to the values along it.
    """

    direction: FloatArray
    fitted: QuasiPeriodic


def breathing_in_beats(t_s: FloatArray, values: FloatArray) -> BreathInBeats | None:
    """Find breathing in (n, columns) values of beats: in one column or in all; None if they show none."""
    columns = _varying(values, LEAST_SPREAD)
    if len(t_s) < LEAST_BEATS or not columns.size:
        return None
    _, axes = np.linalg.eigh(np.cov((values @ columns).T).reshape(columns.shape[1], -1))
    about_s = strongest_period_s(t_s, _clipped(values @ columns))
    beats = []
    for direction in (*columns.T, columns @ axes[:, -1]):
        along = _clipped(values @ direction)
        beats.append(BreathInBeats(direction, fit_quasi_periodic(t_s, along, about_s)))
    best = max(beats, key=lambda one: one.fitted.gain)
    return best if best.fitted.gain >= LEAST_GAIN else None


def breath_rates(t_s: FloatArray, values: FloatArray) -> FloatArray:
    """Compute the rate, 1/min, of the strongest oscillation of (n, columns) values of beats by windows."""
    good = np.isfinite(values).all(axis=1)
    t_s, values = t_s[good], values[good]
    rates = []
    for begin_s in np.arange(t_s[0], t_s[-1] - WINDOW_S, 0.5 * WINDOW_S) if len(t_s) else ():
        inside = (t_s >= begin_s) & (t_s < begin_s + WINDOW_S)
        columns = _varying(values[inside], 0.0) if inside.sum() >= LEAST_BEATS else np.empty((0, 0))
        if columns.size:
            rates.append(60.0 / strongest_period_s(t_s[inside], _clipped(values[inside] @ columns)))
    return np.array(rates)


def _varying(values: FloatArray, least_spread: float) -> FloatArray:
    """Return (columns, k) scaled unit vectors of the columns that vary by more."""
    spread = np.median(np.abs(values - np.median(values, axis=0)), axis=0)
    varies = np.flatnonzero(spread > least_spread)
    return np.asarray(np.eye(len(spread))[:, varies] / spread[varies])


def _clipped(values: FloatArray) -> FloatArray:
    """Limit distances from the median, taken off, which a beat of another origin has."""
    away = values - np.median(values, axis=0)
    most = MOST_SPREADS * np.median(np.abs(away), axis=0)
    return np.clip(away, -most, most)


class BeatClock:
    """Causal breathing clock over beats; it begins with some that show breathing.

    Args:
        t_s, values: (n,), (n, columns) of the beats.
        found: in them, see `breathing_in_beats`.
    """

    continuous = False

    def __init__(self, t_s: FloatArray, values: FloatArray, found: BreathInBeats) -> None:
        self._direction, self._fitted = found.direction, found.fitted
        along = values @ found.direction
        self._middle = float(np.median(along))
        along = self._middle + _clipped(along)
        self._beats: deque[tuple[float, float]] = deque(zip(t_s.tolist(), along.tolist(), strict=True))
        self._ordinary_from_s = -math.inf
        self._missed = 0.0  # normalised error of the last beat's forecast
        self._latest_s = float(t_s[-1])
        self._onsets: deque[float] = deque(maxlen=7)
        self._armed = False
        self._counted_s = -math.inf  # onsets are counted until here
        times = np.arange(t_s[0], t_s[-1], STEP_S)
        scale = learn_scale(found.fitted.predict(t_s, along - self._middle, times)[0][:, None])
        self._origin = 0.0 if scale is None else float(scale.origin[0])
        self._per_unit = 0.0 if scale is None else float(scale.direction[0])
        self._table = np.empty((0, 6))  # time, ρ, its two lags, σ, 1 where they do not tell the heart's place
        self._extend(float(t_s[0]))

    @property
    def latest_s(self) -> float:
        """R peak of the latest beat."""
        return self._latest_s

    @property
    def lost_s(self) -> float:
        """Time without a beat after which breathing is lost."""
        return AHEAD_S

    @property
    def onsets_s(self) -> tuple[float, ...]:
        """Beginnings of the last breaths."""
        return tuple(self._onsets)

    @property
    def period_s(self) -> float:
        """Length of a breath."""
        return self._fitted.period_s

    def add(self, t_s: float, values: FloatArray) -> None:
        """Add a beat with its (columns,) values; NaN values and beats of another origin are left out."""
        self._latest_s, value = t_s, float(values @ self._direction)
        if math.isfinite(value) and not self._foreign(value):
            if self._is_unexpected(t_s, value):
                self._beats.clear()
                self._ordinary_from_s = t_s
            self._beats.append((t_s, value))
            if len(self._beats) > MOST_BEATS:
                self._beats.popleft()
            self._fit()
        self._extend(t_s - REVISED_S)

    def reading(self, t_s: float) -> BreathReading:
        """Read the clock at a time."""
        row = [float(np.interp(t_s, self._table[:, 0], column)) for column in self._table[:, 1:].T]
        begin_s = self._onsets[-1] if self._onsets else math.nan
        phase = min((t_s - begin_s) / self.period_s, math.nextafter(1.0, 0.0))
        state, event = BreathState.LOCKED, BreathEvent.NONE
        if t_s - self._latest_s > AHEAD_S:
            state, event = BreathState.LOST, BreathEvent.DISCONNECTION
        elif row[4] > 0.0:
            state, event = BreathState.IRREGULAR, BreathEvent.UNEXPECTED
        return BreathReading(row[0], row[3], phase, self.period_s, state, event)

    def features(self, t_s: FloatArray) -> FloatArray:
        """Compute (n, 4) rows [1, ρ, L₀.₃ρ, L₀.₇ρ]; NaN before the first beat and beyond the forecast."""
        out = np.full((len(t_s), 4), np.nan)
        inside = (t_s >= self._table[0, 0]) & (t_s <= self._table[-1, 0])
        out[inside, 0] = 1.0
        for k in (1, 2, 3):
            out[inside, k] = np.interp(t_s[inside], self._table[:, 0], self._table[:, k])
        return out

    def tells(self, t_s: FloatArray) -> BoolArray:
        """Return whether `features` at (n,) times tell where the heart is."""
        return np.asarray(np.interp(t_s, self._table[:, 0], self._table[:, 5]) == 0.0)

    def rest_level(self, share: float) -> float:
        """Return the level below which ρ and both of its lags were for `share` of the remembered time."""
        return float(np.quantile(self._usual_rows().max(axis=1), share))

    def rest_features(self, share: float) -> FloatArray:
        """Return the mean (4,) row of `features` below that level."""
        rows = self._usual_rows()
        return np.concatenate([[1.0], rows[rows.max(axis=1) <= self.rest_level(share)].mean(axis=0)])

    def _usual_rows(self) -> FloatArray:
        past = self._table[self._table[:, 0] <= self._latest_s]
        usable = past[:, 5] == 0.0
        return np.asarray(past[usable, 1:4] if usable.any() else past[:, 1:4])

    def _foreign(self, value: float) -> bool:
        rho = (value - self._middle - self._origin) * self._per_unit
        return not -ANOTHER_ORIGIN < rho < 1.0 + ANOTHER_ORIGIN

    def _arrays(self) -> tuple[FloatArray, FloatArray]:
        t_s, values = np.array(self._beats).T
        return t_s, values - self._middle

    def _is_unexpected(self, t_s: float, value: float) -> bool:
        """Whether a beat, or it with the one before, lies too far from the forecast."""
        if not self._beats:
            return False
        mean, sigma = self._fitted.forecast(*self._arrays(), t_s)
        before, self._missed = self._missed, (value - self._middle - mean) / (UNDERSTATED * sigma)
        return max(abs(self._missed), abs(self._missed + before) / math.sqrt(2.0)) > UNEXPECTED

    def _fit(self) -> None:
        """Fit again; with few beats since something unexpected the parameters stay."""
        count = len(self._beats)
        if count >= LEAST_BEATS:
            t_s, along = self._arrays()
            about_s = strongest_period_s(t_s, along[:, None]) if count == LEAST_BEATS else self.period_s
            self._fitted = fit_quasi_periodic(t_s, along, about_s)

    def _extend(self, from_s: float) -> None:
        """Compute the table again from a time on, until AHEAD_S after the latest beat."""
        table = self._table[self._table[:, 0] < from_s]
        table = table[table[:, 0] >= self._latest_s - KEEP_S]
        begin_s = float(table[-1, 0]) + STEP_S if len(table) else from_s
        t_s = np.arange(begin_s, self._latest_s + AHEAD_S, STEP_S)
        if self._beats:
            mean, sigma = self._fitted.predict(*self._arrays(), t_s)
        else:
            mean, sigma = np.zeros(len(t_s)), np.full(len(t_s), math.sqrt(self._fitted.variance))
        rho = (mean - self._origin) * self._per_unit
        columns = [t_s, rho]
        for k, tau_s in enumerate(LAG_S):
            share = 1.0 - math.exp(-STEP_S / tau_s)
            start = float(table[-1, 2 + k]) if len(table) else float(rho.mean())
            columns.append(lfilter([share], [1.0, share - 1.0], rho, zi=[(1.0 - share) * start])[0])
        columns.append(UNDERSTATED * abs(self._per_unit) * sigma)
        self._table = np.vstack([table, np.column_stack([*columns, np.zeros(len(t_s))])])
        new = self._table[len(table) :]
        new[:, 5] = (new[:, 4] > MOST_SIGMA) | (not self._breathes_as_usual())
        self._count_onsets()

    def _breathes_as_usual(self) -> bool:
        """Whether nothing unexpected has happened for ORDINARY_BREATHS, and the last had the usual depth."""
        if self._latest_s < self._ordinary_from_s + ORDINARY_BREATHS * self.period_s:
            return False
        past = self._table[self._table[:, 0] <= self._latest_s]
        breath = past[past[:, 0] > self._latest_s - self.period_s, 1]
        return bool(DEPTHS[0] <= np.ptp(breath) <= DEPTHS[1])

    def _count_onsets(self) -> None:
        """Find where breaths begin: once L₀.₃ρ was low it rises through BEGIN."""
        final_s = self._latest_s - REVISED_S
        rows = self._table[(self._table[:, 0] > self._counted_s) & (self._table[:, 0] <= final_s)]
        for at_s, slow in rows[:, [0, 2]].tolist():
            if slow < ARM:
                self._armed = True
            elif self._armed and slow > BEGIN:
                self._armed = False
                self._onsets.append(at_s)
        self._counted_s = max(self._counted_s, final_s)
