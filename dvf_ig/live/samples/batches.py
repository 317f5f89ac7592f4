"""Values and times of ECG samples that arrive in batches: from their time stamp, else by counting.

Sample k was taken at start + k/rate, and no batch arrives before its last sample: the smallest
arrival − k/rate up to now gives the start. It grows by LARGEST_RATE, so that a slow clock is followed.
If samples were lost, or a source stopped, the count starts again.
"""

from math import inf

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.core.plausible import ECG_VALUE

LARGEST_RATE = 500e-6
LOST_S = 0.15
"""Delay of a batch, compared with the fastest before it, from which others before it were lost."""


class BatchClock:
    """Clock that estimates when the first sample of each batch was taken.

    Args:
        rate_hz: samples a second.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._count, self._start_s, self._last_s = 0, inf, 0.0

    def first_s(self, samples: int, seen_s: float) -> float:
        """Estimate the time of the first of `samples`, which had all been taken at `seen_s`."""
        self._count += samples
        start_s = seen_s - (self._count - 1) / self._rate_hz
        if start_s - self._start_s > LOST_S:
            self._count, self._start_s = samples, inf
            start_s = seen_s - (samples - 1) / self._rate_hz
        crept_s = self._start_s + LARGEST_RATE * (seen_s - self._last_s)
        self._start_s, self._last_s = min(start_s, crept_s), seen_s
        return self._start_s + (self._count - samples) / self._rate_hz


def plausible(values: FloatArray) -> FloatArray:
    """Replace values that are not finite or beyond ECG_VALUE by NaN, a missing sample."""
    return np.where(np.abs(values) <= ECG_VALUE, values, np.nan)
