"""A recorded intervention without an end: its streams round after round, with later stamps in each."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count

from dvf_ig.cardiac import stream_recording
from dvf_ig.core import FloatArray, InvalidInputError, Scenario, TriggerTimes, read_only_arrays
from dvf_ig.replay.events import ECG_CHUNK, Timed, events_of
from dvf_ig.session import EcgSamples, ToolPose, TrackedFrame

MIN_BEATS = 10
"""Fewest R peaks of a recording that is repeated."""
OUT_OF_SIGHT_S = 0.3
"""Probe and tool are out of the tracker's sight so long before each round's end: they jump at the seam."""
AFTER_R = 0.5
"""A round begins and ends at this share of a beat, where no wave of the ECG is cut."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One round.

    Attributes:
        begin_s, seconds: of the recording's clock; a whole number of ECG samples.
        ecg: (n, leads) its samples; rate_hz: of these.
        tracked: its frames and tool poses, with their stamps.
    """

    begin_s: float
    seconds: float
    ecg: FloatArray
    rate_hz: float
    tracked: tuple[Timed, ...]

    def events(self) -> Iterator[Timed]:
        """Events without an end, in order of time; the ECG first where stamps are equal."""
        for k in count():
            shift_s = k * self.seconds
            yield from sorted((*self._ecg(k), *self._moved(shift_s)), key=lambda timed: timed[0])

    def _ecg(self, k: int) -> Iterator[Timed]:
        """Stamps follow from the number of the sample alone, so that no rounding adds up."""
        for first in range(0, len(self.ecg), ECG_CHUNK):
            start_s = self.begin_s + (k * len(self.ecg) + first) / self.rate_hz
            yield start_s, EcgSamples(start_s, self.ecg[first : first + ECG_CHUNK])

    def _moved(self, shift_s: float) -> Iterator[Timed]:
        for t_s, event in self.tracked:
            if isinstance(event, ToolPose | TrackedFrame):
                yield t_s + shift_s, replace(event, t_s=t_s + shift_s)


def round_of(scenario: Scenario) -> Round:
    """From the middle of one early beat to the middle of a late one, so that the rhythm goes on at the seam.

    Raises:
        InvalidInputError: too few heart beats.
    """
    ecg = scenario.ecg
    if isinstance(ecg, TriggerTimes):
        raise InvalidInputError("the scenario has a trigger in place of an ECG; take one with an ECG")
    peaks, _ = stream_recording(ecg)
    if len(peaks) < MIN_BEATS:
        raise InvalidInputError(f"the ECG has {len(peaks)} R peaks; needed at least {MIN_BEATS} to repeat it")
    first, last = (
        round((before.t_s + AFTER_R * (after.t_s - before.t_s) - ecg.start_s) * ecg.rate_hz)
        for before, after in (peaks[1:3], peaks[-2:])
    )
    begin_s, seconds = ecg.start_s + first / ecg.rate_hz, (last - first) / ecg.rate_hz
    hidden_s = begin_s + seconds - OUT_OF_SIGHT_S
    tracked = tuple(
        (t_s, _out_of_sight(event) if t_s >= hidden_s else event)
        for t_s, event in events_of(scenario)
        if isinstance(event, ToolPose | TrackedFrame) and begin_s <= t_s < begin_s + seconds
    )
    return Round(begin_s, seconds, ecg.samples[first:last], ecg.rate_hz, tracked)


def _out_of_sight(event: ToolPose | TrackedFrame) -> ToolPose | TrackedFrame:
    if isinstance(event, ToolPose):
        return ToolPose(event.t_s, None)
    return TrackedFrame(event.t_s, event.image, None)
