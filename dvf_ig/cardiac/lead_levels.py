"""Running amplitude of QRS complexes and of noise in each lead, and the leads' weighted sum."""

from collections.abc import Sequence
from math import exp

import numpy as np

from dvf_ig.core import FloatArray

RISE_GAIN, FALL_GAIN = 0.2, 0.05
"""Gains of the level on the deviation of a new beat: fast upwards, slow downwards, so that a run of small
false detections does not pull the threshold down."""
RELEARN_S = 2.0
"""A lead that was off for this long is observed for as long before it is used again."""
NOISE_TIME_S = 0.4
NOISE_QUANTILE = 0.6
"""Noise is this quantile of the envelope, which the complexes hardly influence."""
MIN_CONTRAST = 3.0
"""Lowest level, in multiples of the noise, to which levels decay while no beat comes."""
LEAST_LEVEL = 1e-9
"""Lowest level, in the unit of the ECG: weights divide by it, and a lead without signal has none."""
NOISE_FLOOR = 0.02
"""Smallest noise assumed, as a share of the level: a noise-free lead does not exclude the others."""


class LeadLevels:
    """Running level and noise per lead; `combined` is near 1 at the peak of a typical complex.

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
        self._off_samples = [0] * leads  # samples for which the lead has been off
        self._relearning = [0] * leads  # samples still to observe of a returned lead before it is used
        self._relearned: list[list[float]] = [[] for _ in range(leads)]

    def learn(self, envelope: FloatArray, rate_hz: float, off: Sequence[bool]) -> None:
        """Initialise levels from the first (n, leads) of envelope: second-highest peak, noise quantile.

        Args:
            envelope: of the leads.
            rate_hz: its sampling rate.
            off: leads that are off at its end.
        """
        window = max(2, round(0.55 * rate_hz))
        starts = range(0, max(1, len(envelope) - window + 1), window // 2)
        tops = np.array([envelope[i : i + window].max(axis=0) for i in starts])
        # each beat lies in two of the overlapping windows; a single artefact is not taken for one
        second = np.sort(tops, axis=0)[-min(2, len(tops))]
        self._level = [float(v) + LEAST_LEVEL for v in second]
        self._off_samples = [self._relearn_samples if lead else 0 for lead in off]
        self._noise = [float(v) + LEAST_LEVEL for v in np.quantile(envelope, NOISE_QUANTILE, axis=0)]
        self._update_weights()

    def combined(self, row: Sequence[float], off: Sequence[bool]) -> float:
        """Combine one sample of the leads' envelopes by their weights; leads that are off are left out."""
        self._age += 1
        if self._age % self._period == 0:
            self._update_weights()
        height, off_samples, relearning, noise = 0.0, self._off_samples, self._relearning, self._noise
        for k, value in enumerate(row):
            if off[k]:
                off_samples[k] += 1
                continue
            if off_samples[k] or relearning[k]:
                self._returned(k, value)
                if relearning[k]:
                    continue
            most = self._clip * self._level[k]
            clipped = most if most < value else value
            noise[k] *= self._up if clipped > noise[k] else self._down
            height += self._weights[k] * clipped
        return height

    def _returned(self, k: int, value: float) -> None:
        """Observe a lead that was off for long, then restart it with new levels."""
        if self._off_samples[k] >= self._relearn_samples:
            self._relearning[k], self._relearned[k] = self._relearn_samples, []
        self._off_samples[k] = 0
        if self._relearning[k]:
            self._relearned[k].append(value)
            self._relearning[k] -= 1
            if self._relearning[k] == 0:
                values = np.array(self._relearned[k])
                self._level[k] = float(values.max()) + LEAST_LEVEL
                self._noise[k] = float(np.quantile(values, NOISE_QUANTILE)) + LEAST_LEVEL
                self._update_weights()

    def background(self) -> float:
        """Weighted sum of the noise; close to 1 if no complex stands out (flutter, noise)."""
        return sum(w * noise for w, noise in zip(self._weights, self._noise, strict=True))

    def follow(self, row: Sequence[float]) -> None:
        """Update the levels with the peak of an accepted complex."""
        for k in self._leads:
            deviation = min(row[k], 2.0 * self._level[k]) - self._level[k]
            gain = RISE_GAIN if deviation > 0 else FALL_GAIN
            self._level[k] = max(LEAST_LEVEL, self._level[k] + gain * deviation)
        self._update_weights()

    def decay(self) -> None:
        """Lower the levels after a long time without beat, but not to the level of the noise."""
        self._level = [
            min(level, max(0.8 * level, MIN_CONTRAST * noise, LEAST_LEVEL))
            for level, noise in zip(self._level, self._noise, strict=True)
        ]
        self._update_weights()

    def _update_weights(self) -> None:
        raw = [
            level / max(noise, NOISE_FLOOR * level) ** 2
            for level, noise in zip(self._level, self._noise, strict=True)
        ]
        total = sum(w * level for w, level in zip(raw, self._level, strict=True))
        self._weights = [w / total for w in raw]
