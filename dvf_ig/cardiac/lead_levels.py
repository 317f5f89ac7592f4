"""How high QRS complexes and noise stand in each lead, and how to add the leads up."""

from collections.abc import Sequence

import numpy as np

from dvf_ig.core import FloatArray

RISE, FALL = 0.2, 0.05
"""Share of a beat's surprise that its level takes up: quickly upwards, slowly downwards, so that a run of
false small beats cannot drag the threshold down with it."""
NOISE_TIME_S = 1.5
NOISE_FLOOR = 0.02
"""Smallest noise assumed, as a share of the level: a perfectly clean lead does not silence the others."""


class LeadLevels:
    """Running level and noise per lead; `combined` is near 1 at the top of a usual complex.

    Leads are weighted by level / noise², the weights of a matched filter for independent noise.
    """

    def __init__(self, rate_hz: float, leads: int, clip: float) -> None:
        self._leads = range(leads)
        self._clip = clip
        self._gain = 1.0 / (NOISE_TIME_S * rate_hz)
        self._level = [1.0] * leads
        self._noise = [1.0] * leads
        self._weights = [1.0 / leads] * leads

    def learn(self, envelope: FloatArray, rate_hz: float) -> None:
        """Set levels from a first stretch of (n, leads) envelope: typical tops, mean noise."""
        window = max(2, round(0.55 * rate_hz))
        starts = range(0, max(1, len(envelope) - window + 1), window // 2)
        tops = np.array([envelope[i : i + window].max(axis=0) for i in starts])
        self._level = [float(v) + 1e-9 for v in np.median(tops, axis=0)]
        self._noise = [float(v) + 1e-9 for v in envelope.mean(axis=0)]
        self._weigh()

    def combined(self, row: Sequence[float], off: Sequence[bool]) -> float:
        """One sample of the leads' envelopes as one height; leads that are off do not count."""
        height = 0.0
        for k in self._leads:
            if off[k]:
                continue
            value = min(row[k], self._clip * self._level[k])
            self._noise[k] += self._gain * (value - self._noise[k])
            height += self._weights[k] * value
        return height

    def beat(self, row: Sequence[float]) -> None:
        """Follow the tops of an accepted complex."""
        for k in self._leads:
            surprise = min(row[k], 2.0 * self._level[k]) - self._level[k]
            self._level[k] += (RISE if surprise > 0 else FALL) * surprise
        self._weigh()

    def silence(self) -> None:
        """No beat for long: expect smaller ones."""
        self._level = [0.8 * v for v in self._level]
        self._weigh()

    def _weigh(self) -> None:
        raw = [
            level / max(noise, NOISE_FLOOR * level) ** 2
            for level, noise in zip(self._level, self._noise, strict=True)
        ]
        total = sum(w * level for w, level in zip(raw, self._level, strict=True))
        self._weights = [w / total for w in raw]
