"""The heart's clock from a live ECG or trigger: R peaks in order of detection, the phase from now on."""

from collections import deque
from math import inf

from dvf_ig.cardiac import LeadChange, PhaseClock, RPeak, RPeakDetector, TriggerDetector
from dvf_ig.core import InvalidInputError, PhaseForecast

from .clocks import StampOrder
from .events import EcgSamples, Trigger
from .setup import BeatSource, EcgSource, TriggerSource


class HeartClock:
    """Takes samples or pulses as they come, and lets each R peak count from the moment of its detection on.

    Samples or pulses that come twice, or behind later ones, are dropped; where some are missing the phase is
    lost, as after electrodes that came off.

    Args:
        source: of the beats.
    """

    def __init__(self, source: BeatSource) -> None:
        self.order = StampOrder()
        self._source = source
        self._trigger = TriggerDetector(source.delay_s) if isinstance(source, TriggerSource) else None
        self._ecg: RPeakDetector | None = None
        self._clock = PhaseClock()
        self._peaks: deque[RPeak] = deque()
        self._changes: deque[LeadChange] = deque()

    @property
    def next_s(self) -> float:
        """When the next R peak is detected, or the ECG is lost or returns; infinite where nothing waits."""
        peak_s = self._peaks[0].detected_at_s if self._peaks else inf
        return min(peak_s, self._changes[0].t_s if self._changes else inf)

    def push(self, event: EcgSamples | Trigger) -> bool:
        """Take the next samples, or the next pulse; False if not later than all before, and dropped.

        Raises:
            InvalidInputError: of another source; another number of leads than before.
        """
        if isinstance(event, Trigger) and self._trigger is not None:
            if not self.order.accepts(event.t_s):
                return False
            self._peaks.extend(self._trigger.push(event.t_s))
            self._changes.extend(self._trigger.take_lead_changes())
        elif isinstance(event, EcgSamples) and isinstance(self._source, EcgSource):
            count, leads = event.samples.shape
            if self._ecg is None:
                self._ecg = RPeakDetector(self._source.rate_hz, leads)
            last_s = event.start_s + (count - 1) / self._source.rate_hz
            if count and leads == self._ecg.leads and not self.order.accepts(event.start_s, last_s):
                return False
            self._peaks.extend(self._ecg.push(event.samples, event.start_s))
            self._changes.extend(self._ecg.take_lead_changes())
        else:
            raise InvalidInputError(
                f"{type(event).__name__} came to a session whose beats come from {self._source}; "
                "set it up with the source that there is"
            )
        return True

    def step(self) -> RPeak | None:
        """Advance to `next_s`; return the R peak if it is one."""
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
