"""Time of the R peak within a QRS complex."""

import numpy as np

from dvf_ig.core import FloatArray

SEARCH_S = 0.08
"""Largest distance of the R peak from the centre of the complex's energy."""
BASELINE_S = 0.30
"""Signal before the complex that gives the local mean."""
TAPER = 0.3
"""Reduction of the weight from the middle of the search window to its edge."""
SWITCH_RATIO = 3.0
"""R is timed in the first lead unless another one is this many times higher."""
HEIGHT_GAIN = 0.1
"""Gain of the running height of each lead."""


class RLocator:
    """Buffer of a few seconds of signal, in which R is the largest deflection from the local mean."""

    def __init__(self, rate_hz: float, leads: int) -> None:
        self._rate = rate_hz
        self._smooth = max(0, round(0.0042 * rate_hz) // 2)
        self._samples = np.zeros((0, leads))
        self._first = 0
        self._keep = round(5.0 * rate_hz)
        self._height = np.zeros(leads)

    def push(self, samples: FloatArray) -> None:
        """Append (n, leads) finite samples."""
        self._samples = np.concatenate([self._samples, samples])

    def discard_old(self) -> None:
        """Discard samples that no later complex can need."""
        surplus = len(self._samples) - self._keep
        if surplus > 0:
            self._samples, self._first = self._samples[surplus:], self._first + surplus

    def locate(self, center: float, now: int) -> float:
        """Locate a complex's R peak (a sample position) near `center`, from samples up to `now`."""
        half_width = round(SEARCH_S * self._rate)
        middle = round(center)
        low = max(self._first, middle - half_width)
        high = min(now, middle + half_width)
        start = max(self._first, middle - round(BASELINE_S * self._rate))
        if high <= low:
            return float(max(middle, self._first))
        near = self._samples[start - self._first : high + 1 - self._first]
        deflection = np.abs(_smoothed(near, self._smooth) - near.mean(axis=0))[low - start :]
        weight = 1.0 - TAPER * np.abs(np.arange(low, high + 1) - middle) / half_width
        weighted = deflection * weight[:, None]
        self._height += HEIGHT_GAIN * (weighted.max(axis=0) - self._height)
        lead = 0
        strongest = int(self._height.argmax())
        if self._height[strongest] > SWITCH_RATIO * self._height[0]:
            lead = strongest
        return float(low + int(weighted[:, lead].argmax()))


def _smoothed(samples: FloatArray, half: int) -> FloatArray:
    """Moving mean over 2·half + 1 samples, edges repeated."""
    if half == 0:
        return samples
    padded = np.concatenate([samples[:1].repeat(half, 0), samples, samples[-1:].repeat(half, 0)])
    width = 2 * half + 1
    return np.asarray(sum(padded[k : k + len(samples)] for k in range(width)) / width)
