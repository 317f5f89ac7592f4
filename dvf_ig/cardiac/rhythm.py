"""Forecast of the current RR interval and of its uncertainty."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from .beat_pattern import BeatKind, BeatPattern
from .rr_predictor import make_predictor

FIRST_EARLY, FIRST_LATE = 0.65, 1.35
"""Early and late intervals relative to the normal one, before the first observation."""
FIRST_SPREAD = 0.1
STATISTICS_GAIN = 0.15
COMPENSATED_SHARE = 0.25
"""Compensatory pause: it and the early beat before it last two normal intervals, within this share of one."""


EARLY_SHARE = 0.85
"""An interval below this share of the normal one ended early."""
LATE_SHARE = 1.2
"""An interval above this share of the normal one ended late."""
LEARN_BEATS = 4
"""Intervals before any is classified."""
NEW_RATE_BEATS = 4
"""Irregular intervals in a row that agree with each other and so make a new rate."""
NEW_RATE_SHARE = 0.12
"""Largest deviation of the intervals of a new rate from their median."""
RESIDUAL_BEATS = 16
"""Intervals over which irregularity is measured."""
SPREAD_GAIN = 0.1
"""Gain of the running variance on a normal interval's squared error."""


@dataclass(frozen=True, slots=True)
class RrForecast:
    """Forecast of the current RR interval.

    Attributes:
        rr_s: most likely length; NaN before the first interval.
        spread: one standard deviation of the length, relative to rr_s.
        normal_s: length if it ends neither early nor late.
        longest_s: longest of the likely lengths.
        ectopic: the beat that began this interval came early: its motion is not the model's.
        unreliable: that, or the last early beat had no compensatory pause: it may be a false detection.
        early: the next beat is expected early.
    """

    rr_s: float
    spread: float
    normal_s: float
    longest_s: float
    ectopic: bool
    unreliable: bool
    early: bool


NO_FORECAST = RrForecast(
    float("nan"), float("nan"), float("nan"), float("nan"), ectopic=False, unreliable=False, early=False
)


class IntervalStatistics:
    """Running mean and variance of one kind of interval, relative to the normal one."""

    def __init__(self, mean: float) -> None:
        self.mean, self.variance = mean, FIRST_SPREAD**2

    def add(self, relative: float) -> None:
        deviation = relative - self.mean
        self.mean += STATISTICS_GAIN * deviation
        self.variance += STATISTICS_GAIN * (deviation**2 - self.variance)


class Rhythm:
    """Rhythm model: takes finished intervals in order and forecasts the current one.

    Normal intervals are predicted from normal ones alone: an early beat and the pause after it do not change
    that prediction. Whether the current one is normal is forecast from the pattern of irregular beats.
    """

    def __init__(self) -> None:
        self._restart(())
        self._residuals: deque[float] = deque(maxlen=RESIDUAL_BEATS)
        self._variance = 0.05**2
        self.forecast = NO_FORECAST

    @property
    def irregularity(self) -> float:
        """Median relative error of the forecast over the last intervals; NaN before there are enough.

        Ectopic beats are few or follow a pattern, so they have little influence on the median; in
        fibrillation the forecast fails beat by beat.
        """
        if len(self._residuals) < RESIDUAL_BEATS:
            return float("nan")
        return float(np.median(self._residuals))

    def add(self, interval_s: float) -> BeatKind:
        """A finished interval."""
        self._recent.append(interval_s)
        kind = BeatKind.NORMAL
        if self._intervals >= LEARN_BEATS:
            kind = self._classify(interval_s)
            self._residuals.append(min(abs(interval_s / self.forecast.rr_s - 1.0), 1.0))
            self._learn(kind, interval_s)
        else:
            self._predictor.add(interval_s)
        self._intervals += 1
        self._kinds.append(kind)
        if kind != BeatKind.NORMAL and self._new_rate():
            self._restart(tuple(self._recent))
            kind = BeatKind.NORMAL
        self._update_forecast(kind)
        return kind

    def _classify(self, interval_s: float) -> BeatKind:
        relative = interval_s / self.forecast.normal_s
        if relative < EARLY_SHARE:
            return BeatKind.EARLY
        late = relative > LATE_SHARE and not self.forecast.ectopic
        return BeatKind.LATE if late else BeatKind.NORMAL

    def _learn(self, kind: BeatKind, interval_s: float) -> None:
        normal = self.forecast.normal_s
        relative = min(interval_s / normal, 2.0)
        self._pattern.add(kind)
        if kind != BeatKind.NORMAL or self.forecast.ectopic:
            self._statistics(self.forecast.ectopic)[kind].add(relative)
            # the prediction is continued as if the replaced sinus beat had come when expected
            self._predictor.add(normal)
            return
        self._variance += SPREAD_GAIN * ((relative - 1.0) ** 2 - self._variance)
        self._predictor.add(interval_s)

    def _uncompensated(self) -> bool:
        """Return whether the last two intervals, early beat and pause, do not add up to two normal ones."""
        if not self.forecast.ectopic:
            return False
        pair = self._recent[-1] + self._recent[-2]
        return bool(abs(pair / self.forecast.normal_s - 2.0) > COMPENSATED_SHARE)

    def _statistics(self, ectopic: bool) -> dict[BeatKind, IntervalStatistics]:
        return self._after_early if ectopic else self._after_normal

    def _new_rate(self) -> bool:
        recent = np.array(self._recent)
        if len(recent) < NEW_RATE_BEATS or any(kind == BeatKind.NORMAL for kind in self._kinds):
            return False
        middle = np.median(recent)
        return bool((np.abs(recent - middle) <= NEW_RATE_SHARE * middle).all())

    def _restart(self, intervals_s: tuple[float, ...]) -> None:
        """Discard what was learnt and start from intervals that agree with each other."""
        self._predictor = make_predictor("ar8")
        self._pattern = BeatPattern()
        early, late = IntervalStatistics(FIRST_EARLY), IntervalStatistics(FIRST_LATE)
        self._after_normal = {BeatKind.EARLY: early, BeatKind.LATE: late}
        self._after_early = {
            BeatKind.NORMAL: IntervalStatistics(2.0 - FIRST_EARLY),
            BeatKind.EARLY: IntervalStatistics(FIRST_EARLY),
            BeatKind.LATE: late,
        }
        self._intervals = len(intervals_s)
        self._recent: deque[float] = deque(intervals_s, maxlen=NEW_RATE_BEATS)
        self._kinds: deque[BeatKind] = deque(maxlen=NEW_RATE_BEATS)
        for interval_s in intervals_s:
            self._predictor.add(interval_s)

    def _update_forecast(self, kind: BeatKind) -> None:
        normal, ectopic = self._predictor.predict(), kind == BeatKind.EARLY
        statistics = self._statistics(ectopic)
        means, variances = np.array([1.0, 0, 0]), np.array([self._variance, 0, 0])
        for which, one in statistics.items():
            means[which], variances[which] = one.mean, one.variance
        probabilities = self._pattern.probabilities()
        likely = int(probabilities.argmax())
        ratio = means[likely]
        variance = float(probabilities @ (variances + (means - ratio) ** 2))
        self.forecast = RrForecast(
            float(ratio * normal),
            float(np.sqrt(variance) / ratio),
            normal,
            float(max(means[likely], means[BeatKind.NORMAL]) * normal),
            ectopic,
            unreliable=ectopic or self._uncompensated(),
            early=likely == BeatKind.EARLY,
        )
