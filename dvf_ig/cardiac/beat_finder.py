"""QRS detection on the envelope's peaks: adaptive threshold, refractory period, search-back."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .lead_levels import LeadLevels

RHYTHM_BEATS, RHYTHM_S = 4, 8.0
"""A rhythm is present while the last four beats lie within eight seconds."""


@dataclass(frozen=True, slots=True)
class RPeakOptions:
    """Settings of the QRS detector; thresholds are shares of the amplitude of recent complexes.

    Attributes:
        learning_s: signal needed before the first decision; its beats are reported as detected at its end.
        refractory_s: no second beat within this time, unless it is `override` times as high as the first.
        t_wave_s: until this time after a beat the threshold falls from `t_wave_share` to `share`.
        t_wave_share: threshold at the end of the refractory period, above T waves.
        share: normal threshold.
        late_share: the threshold falls to this while the next beat is overdue.
        search_back_share: threshold of the search-back.
        search_back_rr: search back when no beat came for this many RR intervals.
        close_share: a peak is complete when the envelope has fallen to this share of its maximum.
        close_s: or when its maximum lies this far back.
        override: height against the previous beat at which a second complex replaces it.
        contrast: a complex must be this many times as high as the noise between complexes.
        start_contrast: the same while no rhythm is present, so that noise alone is never detected as one.
        clip: a lead contributes at most this many times its typical amplitude.
    """

    learning_s: float = 2.0
    refractory_s: float = 0.24
    t_wave_s: float = 0.40
    t_wave_share: float = 0.75
    share: float = 0.42
    late_share: float = 0.25
    search_back_share: float = 0.2
    search_back_rr: float = 1.5
    close_share: float = 0.6
    close_s: float = 0.09
    override: float = 1.8
    clip: float = 2.5
    contrast: float = 2.0
    start_contrast: float = 3.3


@dataclass(frozen=True, slots=True)
class Complex:
    """A candidate QRS complex, a peak of the envelope.

    Attributes:
        top: sample of its maximum.
        decided: sample at which it was classified.
        height: of the maximum, as a share of recent complexes.
    """

    top: int
    decided: int
    height: float


class BeatFinder:
    """Streaming QRS detector: one envelope sample of all leads at a time gives the beats it decided."""

    def __init__(self, rate_hz: float, leads: int, options: RPeakOptions, warm_up: int = 0) -> None:
        """Peaks within the first `warm_up` samples, the transient of the envelope's filters, are ignored."""
        self._warm_up = warm_up
        self._rate, self._second = rate_hz, round(rate_hz)
        self._options = options
        self._close_samples = options.close_s * rate_hz
        self._levels = LeadLevels(rate_hz, leads, options.clip)
        self._learning: list[tuple[Sequence[float], Sequence[bool]]] = []
        self._learnt = False
        self._history: deque[Sequence[float]] = deque(maxlen=round(4.0 * rate_hz))
        self._now = -1
        self._top, self._top_at = 0.0, 0
        self._last: int | None = None
        self._last_height = 0.0
        self._rr = 0.8 * rate_hz
        self._intervals: deque[int] = deque(maxlen=8)
        self._recent: deque[int] = deque(maxlen=RHYTHM_BEATS)
        self._candidates: deque[Complex] = deque(maxlen=16)

    def step(self, row: Sequence[float], off: Sequence[bool]) -> list[Complex]:
        """Process envelope values and "lead off" flags of the next sample."""
        if self._learnt:
            return self._decide(row, off)
        self._learning.append((row, off))
        if len(self._learning) < self._options.learning_s * self._rate:
            return []
        return self._finish_learning()

    def _finish_learning(self) -> list[Complex]:
        """Classify the first seconds once their levels are known; their beats are detected only now."""
        self._learnt = True
        rows = np.array([row for row, _ in self._learning])
        self._levels.learn(rows, self._rate, self._learning[-1][1])
        beats = [beat for row, off in self._learning for beat in self._decide(row, off)]
        self._learning = []
        return [Complex(beat.top, self._now, beat.height) for beat in beats]

    def _decide(self, row: Sequence[float], off: Sequence[bool]) -> list[Complex]:
        self._now += 1
        self._history.append(row)
        height = self._levels.combined(row, off)
        beats: list[Complex] = []
        if height > self._top:
            self._top, self._top_at = height, self._now
        elif height < self._options.close_share * self._top or self._now - self._top_at > self._close_samples:
            self._classify(beats)
            self._top, self._top_at = height, self._now
        if self._last is not None:
            self._search_back(self._now - self._last, beats)
        return beats

    def _classify(self, beats: list[Complex]) -> None:
        """Classify the peak that just ended: a beat, a candidate for search-back, or neither."""
        if self._top_at < self._warm_up:
            return
        peak = Complex(self._top_at, self._now, self._top)
        options = self._options
        since = np.inf if self._last is None else (peak.top - self._last) / self._rate
        if since <= options.refractory_s:
            if since > 0.08 and peak.height > max(options.override * self._last_height, 0.6):
                self._accept(peak, beats, regular=False)
        elif peak.height > max(self._threshold(since), self._min_height()):
            self._accept(peak, beats)
        else:
            self._candidates.append(peak)

    def _min_height(self) -> float:
        """Height that a complex must reach to stand out from the noise; larger if no rhythm is present."""
        options = self._options
        rhythm = len(self._recent) == RHYTHM_BEATS and self._now - self._recent[0] < RHYTHM_S * self._rate
        return (options.contrast if rhythm else options.start_contrast) * self._levels.background()

    def _threshold(self, since_s: float) -> float:
        """Threshold `since_s` after the last beat, as a share of the level of recent complexes."""
        options, rr_s = self._options, self._rr / self._rate
        if since_s < options.t_wave_s:
            fallen = (since_s - options.refractory_s) / (options.t_wave_s - options.refractory_s)
            return options.t_wave_share + (options.share - options.t_wave_share) * fallen
        overdue = min(1.0, max(0.0, (since_s - rr_s) / rr_s))
        return options.share + (options.late_share - options.share) * overdue

    def _search_back(self, waited: int, beats: list[Complex]) -> None:
        """Accept the highest candidate when a beat is overdue; after 2 s lower the levels."""
        options = self._options
        if self._candidates and waited > options.search_back_rr * self._rr:
            last = self._now - waited
            late = [c for c in self._candidates if c.top - last > options.t_wave_s * self._rate]
            best = max(late, key=lambda c: (c.height, c.top), default=None)
            if best is not None and best.height > max(options.search_back_share, self._min_height()):
                self._accept(Complex(best.top, self._now, best.height), beats)
                self._candidates.extend(
                    c for c in late if c.top > best.top + options.refractory_s * self._rate
                )
        if waited > 2 * self._second and waited % self._second == 0:
            self._levels.decay()

    def _accept(self, beat: Complex, beats: list[Complex], *, regular: bool = True) -> None:
        if self._last is not None and regular and beat.top - self._last < 2 * self._rate:
            self._intervals.append(beat.top - self._last)
            self._rr = sorted(self._intervals)[len(self._intervals) // 2]
        self._last, self._last_height = beat.top, beat.height
        self._candidates.clear()
        self._recent.append(beat.top)
        back = self._now - beat.top
        if back < len(self._history):
            self._levels.follow(self._history[-1 - back])
        beats.append(beat)
