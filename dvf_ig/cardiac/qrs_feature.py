"""QRS envelope: a causal wavelet envelope of each ECG lead."""

import numpy as np
from scipy.signal import lfilter

from dvf_ig.core import FloatArray, InvalidInputError

WAVELET_SIGMA_S = 0.013
"""Width of the Gaussian whose first two derivatives form the wavelet; their gain peaks at 12 and 17 Hz."""
SMOOTHING_S = 0.05


class QrsFeature:
    """Streaming envelope |x * g'| ⊕ |x * g''| of each lead, smoothed; bit-identical for any chunks.

    The two Gaussian derivatives are odd and even, so their root of squares has one peak a QRS complex
    whatever its shape; both reject baseline wander and attenuate P and T waves. All filters have linear
    phase: the envelope lags the signal by exactly `delay` samples.

    Attributes:
        delay: samples by which the envelope lags (may end in .5).
    """

    def __init__(self, rate_hz: float, leads: int) -> None:
        if rate_hz < 100.0:
            raise InvalidInputError(
                f"ECG sampling rate is {rate_hz:g} Hz; R peaks need at least 100 Hz: record faster"
            )
        sigma = WAVELET_SIGMA_S * rate_hz
        half_width = int(np.ceil(3.5 * sigma))
        u = np.arange(-half_width, half_width + 1) / sigma
        gaussian = np.exp(-u * u / 2)
        odd, even = -u * gaussian, (u * u - 1) * gaussian
        even = even - even.mean()
        width = max(1, round(SMOOTHING_S * rate_hz))
        self._filters = (_unit_gain(odd), _unit_gain(even))
        self._smoother = np.full(width, 1.0 / width)
        self._states: list[FloatArray] = []
        self._leads = leads
        self.delay = half_width + (width - 1) / 2

    def push(self, samples: FloatArray) -> FloatArray:
        """Convert (n, leads) finite samples to (n, leads) envelope values."""
        if not self._states:
            taps = (*self._filters, self._smoother)
            self._states = [np.zeros((len(b) - 1, self._leads)) for b in taps]
            # start in the steady state of the first sample, so that its offset causes no peak
            for k, b in enumerate(self._filters):
                steady = np.cumsum(b[:0:-1])[::-1]
                self._states[k] = steady[:, None] * samples[0]
        odd, self._states[0] = _sequential(self._filters[0], samples, self._states[0])
        even, self._states[1] = _sequential(self._filters[1], samples, self._states[1])
        envelope, self._states[2] = _sequential(self._smoother, np.hypot(odd, even), self._states[2])
        return envelope


def _sequential(taps: FloatArray, samples: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """FIR filter through the recursive branch of lfilter, whose sums do not depend on the chunks."""
    out, state = lfilter(taps, [1.0, 0.0], samples, axis=0, zi=state)
    return np.asarray(out), np.asarray(state)


def _unit_gain(taps: FloatArray) -> FloatArray:
    """Taps scaled to unit gain at the frequency they pass best."""
    return np.asarray(taps / np.abs(np.fft.rfft(taps, 8192)).max())
