"""Size of each QRS complex relative to the usual one, which the lungs' filling modulates in each lead."""

from collections import deque
from collections.abc import Sequence

import numpy as np

from dvf_ig.core import FloatArray, Signal

from ..rpeak import RPeak

QRS_S = 0.06
"""Samples this long before and after an R peak are compared."""
LEVEL_S = (0.12, 0.05)
"""The level of the signal is taken from this far to this far before it."""
USUAL_BEATS = 20
KEEP_S = 5.0
HALF_STEP = 1e-6
"""Share of a sample's interval by which half of one is rounded down, however the samples were cut."""


class QrsGain:
    """Gains of beats by lead; causal: they depend on nothing after its R peak was detected.

    Args:
        rate_hz: sampling rate.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._parts: deque[tuple[float, FloatArray]] = deque()
        self._shapes: deque[FloatArray] = deque(maxlen=USUAL_BEATS)

    def push(self, samples: FloatArray, start_s: float) -> None:
        """Add (n, leads) samples in order of time."""
        self._parts.append((start_s, samples))

    def forget(self, now_s: float) -> None:
        """Forget samples KEEP_S before now: a beat is detected sooner than that."""
        while len(self._parts) > 1 and self._parts[1][0] < now_s - KEEP_S:
            self._parts.popleft()

    def gains(self, peak_s: float, detected_s: float) -> FloatArray:
        """Compute (leads,) gains of a beat; NaN unless all its samples had come by its detection."""
        shape = self._shape(peak_s) if detected_s >= peak_s + QRS_S else None
        if shape is None:
            return np.full(self._parts[-1][1].shape[1] if self._parts else 1, np.nan)
        if self._shapes and self._shapes[0].shape != shape.shape:
            self._shapes.clear()
        self._shapes.append(shape)
        usual = np.median(np.array(self._shapes), axis=0)
        square = np.square(usual).sum(axis=0)
        sizes = (shape * usual).sum(axis=0)
        return np.asarray(np.divide(sizes, square, out=np.full(len(square), np.nan), where=square > 0.0))

    def _shape(self, peak_s: float) -> FloatArray | None:
        """Return (n, leads) samples about a peak, above their level; None if any is missing."""
        beyond_s = 1.0 / self._rate_hz
        first_s, last_s = peak_s - LEVEL_S[0] - beyond_s, peak_s + QRS_S + beyond_s
        chosen, times = [], []
        for start_s, samples in self._parts:
            if start_s <= last_s and start_s + len(samples) / self._rate_hz >= first_s:
                chosen.append(samples)
                times.append(start_s + np.arange(len(samples)) / self._rate_hz)
        if not chosen:
            return None
        after_s, values = np.concatenate(times) - peak_s, np.concatenate(chosen)
        steps = np.round(after_s * self._rate_hz - HALF_STEP)
        reach, (begin, end) = round(QRS_S * self._rate_hz), (round(t_s * self._rate_hz) for t_s in LEVEL_S)
        near, level = values[np.abs(steps) <= reach], values[(steps >= -begin) & (steps < -end)]
        if len(near) != 2 * reach + 1 or not len(level) or not np.isfinite(near).all():
            return None
        return np.asarray(near - np.median(level, axis=0))


def beat_values(ecg: Signal, peaks: Sequence[RPeak]) -> tuple[FloatArray, FloatArray]:
    """Return (n,) R peaks of a recording, with (n, leads + 1) gains and the interval before each."""
    qrs, t_s = QrsGain(ecg.rate_hz), np.array([peak.t_s for peak in peaks])
    gains, begin = [], 0
    for peak in peaks:
        end = min(len(ecg), round((peak.detected_at_s - ecg.start_s) * ecg.rate_hz) + 1)
        if end > begin:
            qrs.push(ecg.samples[begin:end], ecg.start_s + begin / ecg.rate_hz)
            begin = end
        gains.append(qrs.gains(peak.t_s, peak.detected_at_s))
        qrs.forget(peak.t_s)
    intervals_s = np.diff(t_s, prepend=np.nan)
    return t_s, np.column_stack([np.array(gains).reshape(len(peaks), -1), intervals_s])
