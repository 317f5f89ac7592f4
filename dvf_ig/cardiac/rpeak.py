"""R peaks from a live ECG: the QRS envelope, the peak within a complex, and when it was detected."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from dvf_ig.core import BoolArray, FloatArray, InvalidInputError, Signal
from dvf_ig.core.plausible import ECG_VALUE, require_plausible

from .beat_finder import BeatFinder, Complex
from .lead_off import LeadChange, LeadOffDetector

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


CHUNK_S = 1.0
"""Length of the chunks in which a whole recording is streamed; the peaks do not depend on it."""


@dataclass(frozen=True, slots=True)
class RPeak:
    """One R peak.

    Attributes:
        t_s: when the R wave peaked.
        detected_at_s: time of the last sample needed to detect it; never before t_s.
        quality: 0 to 1, height of the complex against the recent ones; small for beats found by search-back.
    """

    t_s: float
    detected_at_s: float
    quality: float


class RPeakDetector:
    """Causal detector. Feeding the same samples in any chunks gives the same peaks, bit for bit."""

    def __init__(self, rate_hz: float, leads: int = 1) -> None:
        """Set sampling rate and number of leads; R is timed in the first lead unless that one is weak.

        Raises:
            InvalidInputError: a rate below 100 Hz, or no lead.
        """
        if leads < 1:
            raise InvalidInputError(f"the ECG has {leads} leads; needed at least 1")
        self.rate_hz = rate_hz
        self.leads = leads
        self._origin_s: float | None = None
        self._lead_off = LeadOffDetector(rate_hz, leads)
        self._changes: list[LeadChange] = []
        self._on = True
        self._restart()

    def push(self, samples: FloatArray, start_s: float) -> list[RPeak]:
        """Take the next samples and return the peaks detected with them.

        Args:
            samples: (n, leads), in any unit; NaN where samples are missing.
            start_s: time of the first of them; after a gap the detector restarts.
        Raises:
            InvalidInputError: wrong number of leads, implausible values, or samples that go back in time.
        """
        chunk = np.asarray(samples, dtype=np.float64)
        if chunk.ndim != 2 or chunk.shape[1] != self.leads:
            raise InvalidInputError(f"ECG samples have shape {chunk.shape}; needed (n, {self.leads})")
        if len(chunk) == 0:
            return []
        require_plausible(chunk, ECG_VALUE, "an ECG sample")
        self._check_start(start_s)
        filled, off = self._lead_off.push(chunk)
        envelope = self._feature.push(filled)
        self._locator.push(filled)
        self._record_changes(np.asarray(off.all(axis=1)))
        peaks: list[RPeak] = []
        for row, flags in zip(envelope.tolist(), off.tolist(), strict=True):
            self._count += 1
            beats = self._finder.step(row, flags)
            if beats:
                peaks += map(self._peak, beats)
        self._locator.discard_old()
        return peaks

    def take_lead_changes(self) -> list[LeadChange]:
        """Return losses and returns of the whole ECG since the last call, in order of time."""
        changes, self._changes = self._changes, []
        return changes

    def _restart(self) -> None:
        self._feature = QrsFeature(self.rate_hz, self.leads)
        self._locator = RLocator(self.rate_hz, self.leads)
        self._finder = BeatFinder(self.rate_hz, self.leads, warm_up=round(2 * self._feature.delay))
        self._count = 0

    def _peak(self, beat: Complex) -> RPeak:
        at = self._locator.locate(beat.top - self._feature.delay, beat.decided)
        return RPeak(self._time(at), self._time(beat.decided), min(1.0, beat.height))

    def _record_changes(self, lost: BoolArray) -> None:
        for index in np.flatnonzero(np.diff(np.concatenate([[not self._on], lost]).astype(np.int8))):
            self._on = not lost[index]
            cause = "" if self._on else self._lead_off.cause(int(index))
            self._changes.append(LeadChange(self._time(self._count + int(index)), self._on, cause))

    def _check_start(self, start_s: float) -> None:
        """Check that the chunk continues the last one; follow slow drift of the recorder's clock."""
        if self._origin_s is None:
            self._origin_s = start_s
        expected = self._time(self._count)
        offset = (start_s - expected) * self.rate_hz
        if offset < -1.5:
            raise InvalidInputError(
                f"ECG samples from {start_s:.4f} s came after samples up to {expected:.4f} s; feed them in "
                "order of time and once only"
            )
        if offset > 1.5:
            self._changes.append(LeadChange(start_s, False, "samples skipped"))  # only now is the gap known
            self._changes.append(LeadChange(start_s, True))
            self._on = True
            self._restart()
            self._origin_s = start_s
        elif abs(offset) > 0.5:
            self._origin_s += offset / self.rate_hz

    def _time(self, index: float) -> float:
        return (self._origin_s or 0.0) + index / self.rate_hz


def detect_r_peaks(signal: Signal) -> tuple[RPeak, ...]:
    """Detect all R peaks of a recording, causally.

    Raises:
        InvalidInputError: sampled below 100 Hz.
    """
    detector = RPeakDetector(signal.rate_hz, len(signal.leads))
    step = max(1, round(CHUNK_S * signal.rate_hz))
    peaks: list[RPeak] = []
    for first in range(0, len(signal), step):
        chunk = signal.samples[first : first + step]
        peaks.extend(detector.push(chunk, signal.start_s + first / signal.rate_hz))
    return tuple(peaks)
