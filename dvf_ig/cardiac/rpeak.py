"""R peaks from a live ECG: each with the time at which it was detected."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, InvalidInputError, Signal
from dvf_ig.core.plausible import ECG_VALUE, require_plausible

from .beat_finder import BeatFinder, Complex, RPeakOptions
from .lead_off import LeadChange, LeadOffDetector
from .qrs_feature import QrsFeature
from .r_locator import RLocator

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

    def __init__(self, rate_hz: float, leads: int = 1, options: RPeakOptions | None = None) -> None:
        """Set sampling rate and number of leads; R is timed in the first lead unless that one is weak.

        Raises:
            InvalidInputError: a rate below 100 Hz, or no lead.
        """
        if leads < 1:
            raise InvalidInputError(f"the ECG has {leads} leads; needed at least 1")
        self.rate_hz = rate_hz
        self.leads = leads
        self._options = options or RPeakOptions()
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
            peaks += [self._peak(beat) for beat in self._finder.step(row, flags)]
        self._locator.discard_old()
        return peaks

    def take_lead_changes(self) -> list[LeadChange]:
        """Return losses and returns of the whole ECG since the last call, in order of time."""
        changes, self._changes = self._changes, []
        return changes

    def _restart(self) -> None:
        self._feature = QrsFeature(self.rate_hz, self.leads)
        self._locator = RLocator(self.rate_hz, self.leads)
        self._finder = BeatFinder(
            self.rate_hz, self.leads, self._options, warm_up=round(2 * self._feature.delay)
        )
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


def detect_r_peaks(signal: Signal, options: RPeakOptions | None = None) -> tuple[RPeak, ...]:
    """Detect all R peaks of a recording, causally.

    Raises:
        InvalidInputError: sampled below 100 Hz.
    """
    detector = RPeakDetector(signal.rate_hz, len(signal.leads), options)
    step = max(1, round(CHUNK_S * signal.rate_hz))
    peaks: list[RPeak] = []
    for first in range(0, len(signal), step):
        chunk = signal.samples[first : first + step]
        peaks.extend(detector.push(chunk, signal.start_s + first / signal.rate_hz))
    return tuple(peaks)
