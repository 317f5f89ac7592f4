"""QRS detection on the envelope's peaks: adaptive threshold, refractory period, search-back."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .lead_levels import LeadLevels

RHYTHM_BEATS, RHYTHM_S = 4, 8.0
"""A rhythm is present while the last four beats lie within eight seconds."""


LEARNING_S = 2.0
"""Signal needed before the first decision; its beats are reported as detected at its end."""
REFRACTORY_S = 0.24
"""No second beat within this time, unless it is OVERRIDE times as high as the first."""
T_WAVE_S = 0.40
"""Until this time after a beat the threshold falls from T_WAVE_SHARE to SHARE."""
T_WAVE_SHARE = 0.75
"""Threshold at the end of the refractory period, above T waves."""
SHARE = 0.42
"""Normal threshold; thresholds are shares of the amplitude of recent complexes."""
LATE_SHARE = 0.25
"""The threshold falls to this while the next beat is overdue."""
SEARCH_BACK_SHARE = 0.2
"""Threshold of the search-back."""
SEARCH_BACK_RR = 1.5
"""Search back when no beat came for this many RR intervals."""
CLOSE_SHARE = 0.6
CLOSE_S = 0.09
"""A peak is complete when the envelope has fallen to this share of its maximum, or that is this long ago."""
OVERRIDE = 1.8
"""Height against the previous beat at which a second complex replaces it."""
CLIP = 2.5
"""A lead contributes at most this many times its typical amplitude."""
CONTRAST = 2.0
"""A complex must be this many times as high as the noise between complexes."""
START_CONTRAST = 3.3
"""CONTRAST while no rhythm is present, so that noise alone is never detected as one."""


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

    def __init__(self, rate_hz: float, leads: int, warm_up: int = 0) -> None:
        """Peaks within the first `warm_up` samples, the transient of the envelope's filters, are ignored."""
        self._warm_up = warm_up
        self._rate, self._second = rate_hz, round(rate_hz)
        self._close_samples = CLOSE_S * rate_hz
        self._levels = LeadLevels(rate_hz, leads, CLIP)
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
        if len(self._learning) < LEARNING_S * self._rate:
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
        elif height < CLOSE_SHARE * self._top or self._now - self._top_at > self._close_samples:
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
        since = np.inf if self._last is None else (peak.top - self._last) / self._rate
        if since <= REFRACTORY_S:
            if since > 0.08 and peak.height > max(OVERRIDE * self._last_height, 0.6):
                self._accept(peak, beats, regular=False)
        elif peak.height > max(self._threshold(since), self._min_height()):
            self._accept(peak, beats)
        else:
            self._candidates.append(peak)

    def _min_height(self) -> float:
        """Height that a complex must reach to stand out from the noise; larger if no rhythm is present."""
        rhythm = len(self._recent) == RHYTHM_BEATS and self._now - self._recent[0] < RHYTHM_S * self._rate
        return (CONTRAST if rhythm else START_CONTRAST) * self._levels.background()

    def _threshold(self, since_s: float) -> float:
        """Threshold `since_s` after the last beat, as a share of the level of recent complexes."""
        rr_s = self._rr / self._rate
        if since_s < T_WAVE_S:
            fallen = (since_s - REFRACTORY_S) / (T_WAVE_S - REFRACTORY_S)
            return T_WAVE_SHARE + (SHARE - T_WAVE_SHARE) * fallen
        overdue = min(1.0, max(0.0, (since_s - rr_s) / rr_s))
        return SHARE + (LATE_SHARE - SHARE) * overdue

    def _search_back(self, waited: int, beats: list[Complex]) -> None:
        """Accept the highest candidate when a beat is overdue; after 2 s lower the levels."""
        if self._candidates and waited > SEARCH_BACK_RR * self._rr:
            last = self._now - waited
            late = [c for c in self._candidates if c.top - last > T_WAVE_S * self._rate]
            best = max(late, key=lambda c: (c.height, c.top), default=None)
            if best is not None and best.height > max(SEARCH_BACK_SHARE, self._min_height()):
                self._accept(Complex(best.top, self._now, best.height), beats)
                self._candidates.extend(c for c in late if c.top > best.top + REFRACTORY_S * self._rate)
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
