"""How high QRS complexes and noise stand in each lead, and how to add the leads up."""

from collections.abc import Sequence
from math import exp

import numpy as np

from dvf_ig.core import FloatArray

RISE, FALL = 0.2, 0.05
"""Share of a beat's surprise that its level takes up: quickly upwards, slowly downwards, so that a run of
false small beats cannot drag the threshold down with it."""
RELEARN_S = 2.0
"""A lead that was off for this long is watched for as long before it counts again."""
NOISE_TIME_S = 0.4
NOISE_QUANTILE = 0.6
"""Noise is this quantile of the envelope, which the complexes themselves hardly touch."""
SILENT_CONTRAST = 3.0
"""While no beat comes, levels fall no further than this many times the noise."""
NOISE_FLOOR = 0.02
"""Smallest noise assumed, as a share of the level: a perfectly clean lead does not silence the others."""


class LeadLevels:
    """Running level and noise per lead; `combined` is near 1 at the top of a usual complex.

    Leads are weighted by level / noise², the weights of a matched filter for independent noise.
    """

    def __init__(self, rate_hz: float, leads: int, clip: float) -> None:
        self._leads = range(leads)
        self._clip = clip
        step = 1.0 / (NOISE_TIME_S * rate_hz)
        self._up, self._down = exp(NOISE_QUANTILE * step), exp(-(1.0 - NOISE_QUANTILE) * step)
        self._age, self._period = 0, max(1, round(0.05 * rate_hz))
        self._level = [1.0] * leads
        self._noise = [1.0] * leads
        self._weights = [1.0 / leads] * leads
        self._relearn_samples = round(RELEARN_S * rate_hz)
        self._dark = [0] * leads  # samples for which the lead has been off
        self._fresh = [0] * leads  # samples still to watch a returned lead before it counts
        self._watched: list[list[float]] = [[] for _ in range(leads)]

    def learn(self, envelope: FloatArray, rate_hz: float) -> None:
        """Set levels from a first stretch of (n, leads) envelope: second-highest top, mean noise."""
        window = max(2, round(0.55 * rate_hz))
        starts = range(0, max(1, len(envelope) - window + 1), window // 2)
        tops = np.array([envelope[i : i + window].max(axis=0) for i in starts])
        # each beat lies in two of the overlapping windows, a single artefact is not believed
        second = np.sort(tops, axis=0)[-min(2, len(tops))]
        self._level = [float(v) + 1e-9 for v in second]
        dead = envelope[-max(1, window // 2) :].max(axis=0) < 1e-9
        self._dark = [self._relearn_samples if d else 0 for d in dead.tolist()]
        self._noise = [float(v) + 1e-9 for v in np.quantile(envelope, NOISE_QUANTILE, axis=0)]
        self._weigh()

    def combined(self, row: Sequence[float], off: Sequence[bool]) -> float:
        """One sample of the leads' envelopes as one height; leads that are off do not count."""
        self._age += 1
        if self._age % self._period == 0:
            self._weigh()
        height = 0.0
        for k in self._leads:
            if off[k]:
                self._dark[k] += 1
                continue
            if self._dark[k] or self._fresh[k]:
                self._returned(k, row[k])
                if self._fresh[k]:
                    continue
            value = min(row[k], self._clip * self._level[k])
            self._noise[k] *= self._up if value > self._noise[k] else self._down
            height += self._weights[k] * value
        return height

    def _returned(self, k: int, value: float) -> None:
        """A lead that was off for long is watched for a while, then starts with levels of its own."""
        if self._dark[k] >= self._relearn_samples:
            self._fresh[k], self._watched[k] = self._relearn_samples, []
        self._dark[k] = 0
        if self._fresh[k]:
            self._watched[k].append(value)
            self._fresh[k] -= 1
            if self._fresh[k] == 0:
                watched = np.array(self._watched[k])
                self._level[k] = float(watched.max()) + 1e-9
                self._noise[k] = float(np.quantile(watched, NOISE_QUANTILE)) + 1e-9
                self._weigh()

    def background(self) -> float:
        """Height of what lies between complexes; close to 1 where no complex stands out (flutter, noise)."""
        return sum(w * noise for w, noise in zip(self._weights, self._noise, strict=True))

    def beat(self, row: Sequence[float]) -> None:
        """Follow the tops of an accepted complex."""
        for k in self._leads:
            surprise = min(row[k], 2.0 * self._level[k]) - self._level[k]
            self._level[k] += (RISE if surprise > 0 else FALL) * surprise
        self._weigh()

    def silence(self) -> None:
        """No beat for long: expect smaller ones, but still such that stand out from the noise."""
        self._level = [
            min(level, max(0.8 * level, SILENT_CONTRAST * noise))
            for level, noise in zip(self._level, self._noise, strict=True)
        ]
        self._weigh()

    def _weigh(self) -> None:
        raw = [
            level / max(noise, NOISE_FLOOR * level) ** 2
            for level, noise in zip(self._level, self._noise, strict=True)
        ]
        total = sum(w * level for w, level in zip(raw, self._level, strict=True))
        self._weights = [w / total for w in raw]
