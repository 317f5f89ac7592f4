"""How long the running beat will last, with what certainty."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from .beat_pattern import BeatKind, BeatPattern, PatternOptions
from .rr_predictor import PredictorName, make_predictor

FIRST_EARLY, FIRST_LATE = 0.65, 1.35
"""Early and late intervals relative to the usual one, before any was seen."""
FIRST_SPREAD = 0.1
LENGTH_GAIN = 0.15
COMPENSATED_SHARE = 0.25
"""An early beat and the pause after it make two usual intervals, to within this share of one."""


@dataclass(frozen=True, slots=True)
class RhythmOptions:
    """How intervals are judged.

    Attributes:
        predictor: how the next normal interval is predicted.
        early_share: an interval below this share of the usual one ended early.
        late_share: one above this share of the usual one ended late.
        learn_beats: intervals before any is judged.
        new_rate_beats: irregular intervals in a row that agree with each other make a new rate.
        new_rate_share: how well they must agree with their median.
        residual_beats: intervals over which irregularity is judged.
        spread_gain: share of a normal interval's squared miss that the variance takes up.
        pattern: how irregular beats are forecast.
    """

    predictor: PredictorName = "ar8"
    early_share: float = 0.85
    late_share: float = 1.2
    learn_beats: int = 4
    new_rate_beats: int = 4
    new_rate_share: float = 0.12
    residual_beats: int = 16
    spread_gain: float = 0.1
    pattern: PatternOptions = field(default_factory=PatternOptions)


@dataclass(frozen=True, slots=True)
class RrForecast:
    """The running beat.

    Attributes:
        rr_s: most likely length; NaN before the first interval.
        spread: one standard deviation of the length, relative to rr_s.
        usual_s: length if it ends neither early nor late.
        longest_s: longest of the lengths that are likely.
        ectopic: the beat that began this interval came early: its motion is not the model's.
        unsettled: that, or an early beat was not made up for by its pause: it may have been no beat at all.
        early: the next beat is expected early.
    """

    rr_s: float
    spread: float
    usual_s: float
    longest_s: float
    ectopic: bool
    unsettled: bool
    early: bool


NOTHING_KNOWN = RrForecast(
    float("nan"), float("nan"), float("nan"), float("nan"), ectopic=False, unsettled=False, early=False
)


class Length:
    """Running mean and variance of one kind of interval, relative to the usual one."""

    def __init__(self, mean: float) -> None:
        self.mean, self.variance = mean, FIRST_SPREAD**2

    def add(self, relative: float) -> None:
        miss = relative - self.mean
        self.mean += LENGTH_GAIN * miss
        self.variance += LENGTH_GAIN * (miss**2 - self.variance)


class Rhythm:
    """Takes finished intervals in order; forecasts the running one.

    Normal intervals are predicted from normal ones alone: an early beat and the pause after it leave that
    prediction as it was. Whether the running one is normal is forecast from the pattern of irregular beats.
    """

    def __init__(self, options: RhythmOptions | None = None) -> None:
        self._options = options or RhythmOptions()
        self._begin(())
        self._residuals: deque[float] = deque(maxlen=self._options.residual_beats)
        self._variance = 0.05**2
        self.forecast = NOTHING_KNOWN

    @property
    def irregularity(self) -> float:
        """Median miss of the forecast over the last intervals, relative; NaN before there are enough.

        Ectopic beats are few or follow a pattern, so that the median hardly knows them; fibrillation misses
        beat by beat.
        """
        if len(self._residuals) < self._options.residual_beats:
            return float("nan")
        return float(np.median(self._residuals))

    def add(self, interval_s: float) -> BeatKind:
        """A finished interval."""
        self._recent.append(interval_s)
        kind = BeatKind.NORMAL
        if self._intervals >= self._options.learn_beats:
            kind = self._kind(interval_s)
            self._residuals.append(min(abs(interval_s / self.forecast.rr_s - 1.0), 1.0))
            self._learn(kind, interval_s)
        else:
            self._predictor.add(interval_s)
        self._intervals += 1
        self._kinds.append(kind)
        if kind != BeatKind.NORMAL and self._new_rate():
            self._begin(tuple(self._recent))
            kind = BeatKind.NORMAL
        self._expect(kind)
        return kind

    def _kind(self, interval_s: float) -> BeatKind:
        relative = interval_s / self.forecast.usual_s
        if relative < self._options.early_share:
            return BeatKind.EARLY
        late = relative > self._options.late_share and not self.forecast.ectopic
        return BeatKind.LATE if late else BeatKind.NORMAL

    def _learn(self, kind: BeatKind, interval_s: float) -> None:
        usual = self.forecast.usual_s
        relative = min(interval_s / usual, 2.0)
        self._pattern.add(kind)
        if kind != BeatKind.NORMAL or self.forecast.ectopic:
            self._lengths(self.forecast.ectopic)[kind].add(relative)
            # the sinus beat that the irregular one replaced leaves the prediction as it was
            self._predictor.add(usual)
            return
        self._variance += self._options.spread_gain * ((relative - 1.0) ** 2 - self._variance)
        self._predictor.add(interval_s)

    def _uncompensated(self) -> bool:
        """The last two intervals were an early one and its pause, but not two usual intervals together."""
        if not self.forecast.ectopic:
            return False
        pair = self._recent[-1] + self._recent[-2]
        return bool(abs(pair / self.forecast.usual_s - 2.0) > COMPENSATED_SHARE)

    def _lengths(self, ectopic: bool) -> dict[BeatKind, Length]:
        return self._after_early if ectopic else self._after_normal

    def _new_rate(self) -> bool:
        recent = np.array(self._recent)
        if len(recent) < self._options.new_rate_beats or any(kind == BeatKind.NORMAL for kind in self._kinds):
            return False
        middle = np.median(recent)
        return bool((np.abs(recent - middle) <= self._options.new_rate_share * middle).all())

    def _begin(self, intervals_s: tuple[float, ...]) -> None:
        """Learn anew, from intervals that agree with each other."""
        self._predictor = make_predictor(self._options.predictor)
        self._pattern = BeatPattern(self._options.pattern)
        early, late = Length(FIRST_EARLY), Length(FIRST_LATE)
        self._after_normal = {BeatKind.EARLY: early, BeatKind.LATE: late}
        self._after_early = {
            BeatKind.NORMAL: Length(2.0 - FIRST_EARLY),
            BeatKind.EARLY: Length(FIRST_EARLY),
            BeatKind.LATE: late,
        }
        self._intervals = len(intervals_s)
        self._recent: deque[float] = deque(intervals_s, maxlen=self._options.new_rate_beats)
        self._kinds: deque[BeatKind] = deque(maxlen=self._options.new_rate_beats)
        for interval_s in intervals_s:
            self._predictor.add(interval_s)

    def _expect(self, kind: BeatKind) -> None:
        usual, ectopic = self._predictor.predict(), kind == BeatKind.EARLY
        known = self._lengths(ectopic)
        means, variances = np.array([1.0, 0, 0]), np.array([self._variance, 0, 0])
        for which, length in known.items():
            means[which], variances[which] = length.mean, length.variance
        chances = self._pattern.chances()
        likely = int(chances.argmax())
        ratio = means[likely]
        variance = float(chances @ (variances + (means - ratio) ** 2))
        self.forecast = RrForecast(
            float(ratio * usual),
            float(np.sqrt(variance) / ratio),
            usual,
            float(max(means[likely], means[BeatKind.NORMAL]) * usual),
            ectopic,
            unsettled=ectopic or self._uncompensated(),
            early=likely == BeatKind.EARLY,
        )
