"""Time stamps of the streams: their order within a stream, and the clocks of sources against the local one.

Repeated and reordered samples are dropped, a restarted clock is refused (`StampOrder`). The latency of a link
is never below its least; what the least seems to do over minutes, the source's clock does (`SourceClock`).
With L the least of arrival − stamp over the last blocks, and L₀ that of the first REFERENCE_S,

    stamp on the local clock = stamp + (L − L₀)

follows a clock that is fast or slow by up to LARGEST_RATE. A sudden rise of L may be a link that has become
slow: it is followed at the same rate, and until then the samples are what they seem, late. If stamps go back
the clock did: samples are refused until they are no later than usual again, or until the clock has run
steadily for STEADY_S from where it went to (a source that restarted): then L is what it is now. The same
holds for a clock that went ahead, whose samples are stamped with their arrival meanwhile.
Source: clock filter of NTP (Mills, RFC 5905): the sample of least delay is the best one.
`HeartClock` is the clock of the heart on these times: R peaks in order of detection, the phase from now on.
"""

from collections import deque
from dataclasses import dataclass, replace
from math import inf
from typing import NamedTuple

from dvf_ig.cardiac import LeadChange, PhaseClock, RPeak, RPeakDetector, TriggerDetector
from dvf_ig.core import InvalidInputError, PhaseForecast

from .events import EcgSamples, Event, RespirationSample, ToolPose, TrackedFrame, Trigger
from .setup import BeatSource, EcgSource, TriggerSource

JITTER_S = 0.1
"""A stamp may lie this far before the newest: samples overtook each other. Beyond it the clock restarted."""
WINDOW = 100
DEGRADED_SHARE = 0.1
"""More than this share of the last WINDOW samples dropped degrades (docs/theory/safety.md)."""
REFERENCE_S = 5.0
BLOCK_S = 2.0
"""Least latencies are kept for blocks of this length."""
SPAN_S = 60.0
SKEW = 100e-6
"""A clock that gains or loses more than this over SPAN_S runs away (docs/theory/safety.md)."""
FUTURE_S = 0.005
"""A stamp this far behind its arrival is wrong whatever the drift: its sample is stamped with its arrival."""
LARGEST_RATE = 500e-6
"""No crystal is off by more; a faster change is followed so fast and no faster."""
STEADY_S, STEADY_SAMPLES = 2.0, 3
"""A clock that jumped is followed once this many samples over this time agree on its stamps: longer than the
second after which the force latches (`CLOCK_BACKWARDS`), so that an operator has to let it back."""


class StampOrder:
    """Watches the stamps of one stream, in the order in which its samples arrive.

    A stream may be handed over ahead of time: what is wrong with a sample counts from the newest stamp that
    came before it.
    """

    def __init__(self) -> None:
        self.newest_s = float("-inf")
        self.restarted = False
        """Whether the clock has gone back and no later sample has come since."""
        self.disordered = False
        """Whether too many of the recent samples came late or twice."""
        self._waiting: deque[_Arrival] = deque()
        self._dropped: deque[bool] = deque(maxlen=WINDOW)
        self._dropped_in_a_row = 0

    def accepts(self, t_s: float, last_s: float | None = None) -> bool:
        """Whether a sample stamped `t_s` is later than all before it.

        Args:
            last_s: stamp of the last of several samples that came together; None for a single sample.
        """
        later, back = t_s > self.newest_s, t_s < self.newest_s - JITTER_S
        if later:
            self.newest_s = t_s if last_s is None else last_s
        self._dropped_in_a_row = 0 if later else self._dropped_in_a_row + 1
        if self._dropped_in_a_row <= WINDOW:
            self._waiting.append(_Arrival(self.newest_s, later, back))
        return later

    def advance(self, now_s: float) -> None:
        """Count samples that arrived behind stamps until now; times in order."""
        while self._waiting and self._waiting[0].from_s <= now_s:
            arrival = self._waiting.popleft()
            self._dropped.append(not arrival.later)
            self.disordered = sum(self._dropped) > DEGRADED_SHARE * WINDOW
            self.restarted = arrival.back or (self.restarted and not arrival.later)


class _Arrival(NamedTuple):
    """A sample that arrived: from when it counts, and how its stamp compares with those before."""

    from_s: float
    later: bool
    back: bool


@dataclass(slots=True)
class _Jumped:
    """A clock since it jumped: arrival of the first sample, newest stamp, latencies, samples."""

    from_s: float
    newest_s: float
    first_latency_s: float
    least_s: float
    samples: int = 1

    def goes_on(self, t_s: float, latency_s: float) -> bool:
        """Whether a sample is stamped by the same clock."""
        return t_s > self.newest_s and abs(latency_s - self.first_latency_s) <= JITTER_S

    def steady(self, now_s: float) -> bool:
        return now_s - self.from_s >= STEADY_S and self.samples >= STEADY_SAMPLES


class SourceClock:
    """The clock of one source; samples in the order in which they came."""

    def __init__(self) -> None:
        self.correction_s = 0.0
        """Correction that is added to stamps now."""
        self._reference_s = inf
        self._first_s: float | None = None
        self._last_s = self._block_s = 0.0
        self._block_min_s = inf
        self._blocks: deque[float] = deque(maxlen=round(SPAN_S / BLOCK_S))
        self._newest_s = -inf
        self._jumped: _Jumped | None = None
        self.skewed = False
        """Whether the clock runs away: stamps from the future, or a drift beyond SKEW."""
        self.behind = False
        """Whether the clock went back, and has neither recovered nor run steadily since."""

    def local_s(self, t_s: float, arrived_s: float) -> float | None:
        """Return a stamp on the local clock; None if the sample is to be refused.

        Args:
            t_s: as the source stamped it, of the newest that came together.
            arrived_s: on the local clock, not before the last one.
        """
        if self._first_s is None:
            self._first_s = self._last_s = self._block_s = arrived_s
        latency_s = arrived_s - t_s
        ahead_s = self.correction_s - latency_s
        if ahead_s > FUTURE_S or self._went_back(t_s, latency_s):
            jumped = self._since_jump(t_s, arrived_s, latency_s)
            if FUTURE_S < ahead_s <= JITTER_S or not jumped.steady(arrived_s):
                self.skewed |= ahead_s > FUTURE_S
                return arrived_s if ahead_s > FUTURE_S else None
            self._follow_jump(jumped)
        self._jumped = None
        if arrived_s - self._block_s >= BLOCK_S:
            self._blocks.append(self._block_min_s)
            self._block_s, self._block_min_s = arrived_s, inf
        self._block_min_s = min(self._block_min_s, latency_s)
        if arrived_s - self._first_s < REFERENCE_S:
            self._reference_s = min(self._reference_s, latency_s)
        else:
            reach_s = LARGEST_RATE * (arrived_s - self._last_s)
            missing_s = self._least_s - self._reference_s - self.correction_s
            self.correction_s += min(max(missing_s, -reach_s), reach_s)
        self._last_s = arrived_s
        self.skewed = self._drifts
        return t_s + self.correction_s

    def _went_back(self, t_s: float, latency_s: float) -> bool:
        if t_s < self._newest_s - JITTER_S or self.behind:
            self.behind = latency_s > self._least_s + JITTER_S
        self._newest_s = max(self._newest_s, t_s)
        return self.behind

    def _since_jump(self, t_s: float, arrived_s: float, latency_s: float) -> _Jumped:
        """Describe the clock since it jumped, or since it did so last."""
        jumped = self._jumped
        if jumped is None or not jumped.goes_on(t_s, latency_s):
            jumped = self._jumped = _Jumped(arrived_s, t_s, latency_s, latency_s)
        else:
            jumped.newest_s, jumped.least_s = t_s, min(jumped.least_s, latency_s)
            jumped.samples += 1
        return jumped

    def _follow_jump(self, jumped: _Jumped) -> None:
        """Take the least latency since the jump for the least before; zero if no sample was used before."""
        if self._reference_s == inf:
            self._reference_s = 0.0
        self._first_s = -inf
        self.correction_s = jumped.least_s - self._reference_s
        self._blocks.clear()
        self._block_min_s, self._newest_s, self.behind = jumped.least_s, jumped.newest_s, False

    @property
    def _least_s(self) -> float:
        """Least latency of the running block and the one before."""
        return min(self._block_min_s, self._blocks[-1] if self._blocks else inf)

    @property
    def _drifts(self) -> bool:
        if len(self._blocks) < 2:
            return False
        return abs(self._least_s - min(self._blocks[0], self._blocks[1])) > SKEW * SPAN_S


class SourceClocks:
    """One clock a kind of event; what an operator does is stamped by the local clock.

    Args:
        beats: ECG samples are stamped by their first, and arrive after their last.
    """

    def __init__(self, beats: BeatSource) -> None:
        self._ecg_step_s = 1.0 / beats.rate_hz if isinstance(beats, EcgSource) else 0.0
        self._clocks: dict[type, SourceClock] = {}

    @property
    def skewed(self) -> bool:
        """Whether any source's clock runs away."""
        return any(clock.skewed for clock in self._clocks.values())

    @property
    def behind(self) -> bool:
        """Whether any source's clock went back."""
        return any(clock.behind for clock in self._clocks.values())

    def correction_s(self, kind: type) -> float:
        """Return the correction that is added to the stamps of a kind of event now."""
        return self._clocks[kind].correction_s if kind in self._clocks else 0.0

    def on_local_clock(self, event: Event, arrived_s: float) -> Event | None:
        """Return the event with its stamp corrected; None if it is to be refused."""
        if isinstance(event, EcgSamples):
            length_s = (len(event.samples) - 1) * self._ecg_step_s
            last_s = event.start_s + length_s
            local_s = self._of(event).local_s(last_s, arrived_s)
            if local_s is None or local_s == last_s:
                return event if local_s is not None else None
            return replace(event, start_s=local_s - length_s)
        if isinstance(event, ToolPose | TrackedFrame | Trigger | RespirationSample):
            local_s = self._of(event).local_s(event.t_s, arrived_s)
            if local_s is None or local_s == event.t_s:
                return event if local_s is not None else None
            return replace(event, t_s=local_s)
        return event

    def _of(self, event: Event) -> SourceClock:
        return self._clocks.setdefault(type(event), SourceClock())


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
