"""The heart's clock from a live ECG: samples in, R peaks in order of detection, the phase from now on."""

from collections import deque
from math import inf

from dvf_ig.cardiac import LeadChange, PhaseClock, RPeak, RPeakDetector
from dvf_ig.core import PhaseForecast

from .events import EcgSamples


class HeartClock:
    """Detects R peaks as samples come, and lets each count from the moment of its detection on.

    Args:
        rate_hz: sampling rate of the ECG.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._detector: RPeakDetector | None = None
        self._clock = PhaseClock()
        self._peaks: deque[RPeak] = deque()
        self._changes: deque[LeadChange] = deque()

    @property
    def next_s(self) -> float:
        """When the next R peak is detected, or the ECG is lost or returns; infinite where nothing waits."""
        peak_s = self._peaks[0].detected_at_s if self._peaks else inf
        return min(peak_s, self._changes[0].t_s if self._changes else inf)

    def push(self, event: EcgSamples) -> None:
        """Take the next samples.

        Raises:
            InvalidInputError: another number of leads than before, or samples that go back in time.
        """
        if self._detector is None:
            self._detector = RPeakDetector(self._rate_hz, event.samples.shape[1])
        self._peaks.extend(self._detector.push(event.samples, event.start_s))
        self._changes.extend(self._detector.take_lead_changes())

    def step(self) -> RPeak | None:
        """What happens at `next_s`; the R peak if it is one."""
        if self._peaks and self._peaks[0].detected_at_s <= self.next_s:
            peak = self._peaks.popleft()
            self._clock.add(peak)
            return peak
        change = self._changes.popleft()
        self._clock.signal_changed(change.t_s, change.on)
        return None

    def forecast(self, now_s: float) -> PhaseForecast:
        """Phase from now on, as known now; times in order."""
        return self._clock.forecast(now_s)
