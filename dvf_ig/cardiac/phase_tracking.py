"""Causal phase over a recorded ECG or trigger output: each time uses only what was known by then."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import (
    BoolArray,
    FloatArray,
    InvalidInputError,
    PhaseTrack,
    Progress,
    Signal,
    TriggerTimes,
    part_of,
    read_only_arrays,
    untold,
)
from dvf_ig.core.timing.trigger import check_trigger_delay

from .lead_off import LeadChange
from .phase_clock import SAME_BEAT_S, PhaseClock
from .rpeak import CHUNK_S, RPeak, RPeakDetector

SHORTEST_INTERVAL_S = SAME_BEAT_S
"""Shortest time between pulses of two heart beats (240 per minute)."""


class TriggerDetector:
    """R peaks from trigger pulses.

    Pulses too close to be beats do not show which of them is R, so the trigger counts as lost until the next
    one, as an ECG does while its electrodes are off.
    """

    def __init__(self, delay_s: float = 0.0) -> None:
        """Set `delay_s`, the time by which the device fires after the R peak.

        Raises:
            InvalidInputError: a delay outside 0 to 0.5 s.
        """
        check_trigger_delay(delay_s)
        self._delay_s = delay_s
        self._last_s = float("-inf")
        self._changes: list[LeadChange] = []

    def push(self, t_s: float) -> list[RPeak]:
        """Take the next pulse and return its R peak, `delay_s` before it; none for a double pulse.

        Raises:
            InvalidInputError: the pulse comes before the last one.
        """
        if t_s < self._last_s:
            raise InvalidInputError(
                f"a trigger at {t_s:.4f} s came after the one at {self._last_s:.4f} s; feed them in order"
            )
        double = t_s - self._last_s < SHORTEST_INTERVAL_S
        self._last_s = t_s
        if double:
            self._changes += [LeadChange(t_s, False, "double pulse"), LeadChange(t_s, True)]
            return []
        return [RPeak(t_s - self._delay_s, t_s, 1.0)]

    def take_lead_changes(self) -> list[LeadChange]:
        """Return losses and returns of the trigger since the last call, in order of time."""
        changes, self._changes = self._changes, []
        return changes


def trigger_peaks(trigger: TriggerTimes) -> tuple[tuple[RPeak, ...], tuple[LeadChange, ...]]:
    """Return R peaks of a recorded trigger, and when it was lost and came back."""
    detector = TriggerDetector(trigger.delay_s)
    peaks = [peak for t_s in trigger.t_s.tolist() for peak in detector.push(t_s)]
    return tuple(peaks), tuple(detector.take_lead_changes())


@dataclass(frozen=True, slots=True, eq=False)
class PhaseTracking:
    """R peaks with the phase estimated from them.

    Attributes:
        peaks: in order of detection.
        lead_changes: when the ECG or trigger was lost and when it returned.
        track: phase at the requested times.
    """

    peaks: tuple[RPeak, ...]
    lead_changes: tuple[LeadChange, ...]
    track: PhaseTrack


def track_phase(
    source: Signal | TriggerTimes,
    t_s: FloatArray,
    *,
    progress: Progress = untold,
) -> PhaseTracking:
    """Detect R peaks and estimate phase over a recording, each time from what was known by then.

    Args:
        source: the ECG, or the pulses of a trigger.
        t_s: (n,) strictly increasing times at which phase is computed, in its time base.
        progress: called with the fraction done.
    Raises:
        InvalidInputError: sampled below 100 Hz, or times that do not increase.
    """
    peaks, changes = stream_recording(source, part_of(progress, 0, 2))
    track = phase_from_peaks(peaks, changes, t_s, progress=part_of(progress, 1, 2))
    return PhaseTracking(peaks, changes, track)


def stream_recording(
    source: Signal | TriggerTimes, progress: Progress = untold
) -> tuple[tuple[RPeak, ...], tuple[LeadChange, ...]]:
    """Detect R peaks and lead changes of a whole recording, detected causally."""
    if isinstance(source, TriggerTimes):
        return trigger_peaks(source)
    detector = RPeakDetector(source.rate_hz, len(source.leads))
    step = max(1, round(CHUNK_S * source.rate_hz))
    peaks: list[RPeak] = []
    for first in range(0, len(source), step):
        start_s = source.start_s + first / source.rate_hz
        peaks.extend(detector.push(source.samples[first : first + step], start_s))
        progress(min(1.0, (first + step) / len(source)))
    return tuple(peaks), tuple(detector.take_lead_changes())


def phase_from_peaks(
    peaks: tuple[RPeak, ...],
    changes: tuple[LeadChange, ...],
    t_s: FloatArray,
    *,
    progress: Progress = untold,
) -> PhaseTrack:
    """Estimate phase at each time from the peaks and lead changes known by then.

    Args:
        peaks: in order of detection; each is used from its `detected_at_s` on.
        changes: in order of time.
        t_s: (n,) strictly increasing.
        progress: called with the fraction done.
    """
    times = np.asarray(t_s, dtype=np.float64)
    events: list[tuple[float, int, RPeak | LeadChange]] = [(p.detected_at_s, 0, p) for p in peaks]
    events += [(c.t_s, 1, c) for c in changes]
    events.sort(key=lambda event: (event[0], event[1]))
    clock = PhaseClock()
    out = np.empty((len(times), 4))
    first = 0
    for at_s, _, event in events:
        last = int(np.searchsorted(times, at_s, side="left"))
        _fill(clock, times[first:last], out[first:last])
        first = last
        progress(last / len(times))
        if isinstance(event, RPeak):
            clock.add(event)
        else:
            clock.signal_changed(event.t_s, event.on)
    _fill(clock, times[first:], out[first:])
    return PhaseTrack(times, out[:, 0], out[:, 1], out[:, 2], out[:, 3].astype(np.int64))


def _fill(clock: PhaseClock, t_s: FloatArray, out: FloatArray) -> None:
    """Fill rows (φ, σ_φ, RR, state) at times between two events, each from the forecast that holds there."""
    first = 0
    while first < len(t_s):
        forecast = clock.forecast(float(t_s[first]))
        last = int(np.searchsorted(t_s, forecast.until_s, side="right"))
        out[first:last] = np.column_stack(forecast.at_many(t_s[first:last])[:4])
        first = last


MAX_RR_DEVIATION = 0.2
"""A beat is regular when its RR is within this share of the median of its neighbourhood."""
NEIGHBOURS = 4
"""Beats on each side that form the neighbourhood."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BeatPhase:
    """Phase of times between R peaks.

    Attributes:
        phi: (n,) fraction of the enclosing RR interval, [0, 1); 0 outside any.
        rr_s: (n,) length of that interval; NaN outside any.
        regular: (n,) True if the beat is complete and neither it nor the one before was early or late.
    """

    phi: FloatArray
    rr_s: FloatArray
    regular: BoolArray


def beat_phase(r_peaks_s: FloatArray, t_s: FloatArray) -> BeatPhase:
    """Compute phase at `t_s` from the R peaks before and after it.

    Args:
        r_peaks_s: (k,) increasing.
        t_s: (n,) times at which phase is computed.
    """
    n = len(t_s)
    if len(r_peaks_s) < 2:
        return BeatPhase(np.zeros(n), np.full(n, np.nan), np.zeros(n, dtype=np.bool_))
    rr = np.diff(r_peaks_s)
    normal = np.array([np.median(rr[max(0, k - NEIGHBOURS) : k + NEIGHBOURS + 1]) for k in range(len(rr))])
    regular = np.abs(rr - normal) <= MAX_RR_DEVIATION * normal
    regular[1:] &= np.abs(rr[:-1] - normal[:-1]) <= MAX_RR_DEVIATION * normal[:-1]
    beat = np.searchsorted(r_peaks_s, t_s, side="right") - 1
    inside = (beat >= 0) & (beat < len(rr))
    safe = np.clip(beat, 0, len(rr) - 1)
    phi = np.where(inside, (t_s - r_peaks_s[safe]) / rr[safe], 0.0)
    return BeatPhase(phi, np.where(inside, rr[safe], np.nan), inside & regular[safe])
