"""What a recording must hold before it can be replayed: common time, tracked poses and heart beats."""

from collections.abc import Sized

import numpy as np

from dvf_ig.cardiac import MIN_BEATS
from dvf_ig.core import FloatArray, InvalidInputError, NoOverlapError, PoseStream, Scenario, TriggerTimes

from .start import require_start

RATE_HZ = 1000.0


def tick_times(scenario: Scenario) -> FloatArray:
    """Every millisecond from when ECG and tool are both recorded until the ECG, or tool and probe, end.

    With a trigger in place of the ECG, from the tool's first pose on: a trigger that is silent is no end.

    Raises:
        NoOverlapError: ECG or trigger and tool share less than a second.
    """
    beats_s, tool_s = scenario.ecg.t_s, tool_of(scenario).t_s
    begin = max(float(beats_s[0]), float(tool_s[0]))
    tracked_until = max(float(tool_s[-1]), float(scenario.ultrasound.t_s[-1]))
    end = min(float(beats_s[-1]), tracked_until)
    triggered = isinstance(scenario.ecg, TriggerTimes)
    if min(end, float(tool_s[-1])) - begin < 1.0:
        raise NoOverlapError(
            f"{'trigger' if triggered else 'ECG'} ({beats_s[0]:.1f} to {beats_s[-1]:.1f} s) and tool "
            f"({tool_s[0]:.1f} to {tool_s[-1]:.1f} s) share less than a second; they must be on one clock"
        )
    if triggered:
        begin, end = float(tool_s[0]), tracked_until
    return begin + np.arange(int((end - begin) * RATE_HZ)) / RATE_HZ


def require_replayable(scenario: Scenario) -> None:
    """Raise what keeps a recording from being replayed, as far as it shows without a model or calibrations.

    Raises:
        InvalidInputError: no start, or probe or tool was never tracked.
        NoOverlapError: ECG and tool share less than a second.
    """
    require_start(scenario)
    require_tracked_poses(scenario)
    tick_times(scenario)


def require_registrable(scenario: Scenario) -> None:
    """Raise what keeps a recording from being registered, as far as it shows without a model or calibrations.

    Raises:
        InvalidInputError: no start, or the probe was never tracked.
    """
    require_start(scenario)
    require_tracked_probe(scenario)


def tool_of(scenario: Scenario) -> PoseStream:
    """The tool's poses, which a force needs.

    Raises:
        InvalidInputError: the recording has none.
    """
    if scenario.tool is None:
        raise InvalidInputError("the recording has no tool; a replay needs its poses (tracker_from_tool)")
    return scenario.tool


def require_tracked_probe(scenario: Scenario) -> None:
    """Raise InvalidInputError where the probe was never tracked."""
    _require_valid(scenario.ultrasound.stream("tracker", "probe"), "ultrasound")


def require_tracked_poses(scenario: Scenario) -> None:
    """Raise InvalidInputError where probe or tool was never tracked."""
    require_tracked_probe(scenario)
    _require_valid(tool_of(scenario), "tool")


def _require_valid(stream: PoseStream, what: str) -> None:
    if not stream.valid.any():
        raise InvalidInputError(
            f"{what} recording: none of the {len(stream)} poses of {stream.name} has status OK; "
            "check the line of sight and record again"
        )


def require_heart_beats(peaks: Sized, scenario: Scenario) -> None:
    """Raise InvalidInputError where ECG or trigger shows too few R peaks."""
    ecg = scenario.ecg
    if len(peaks) < MIN_BEATS and isinstance(ecg, TriggerTimes):
        raise InvalidInputError(
            f"the trigger gives {len(peaks)} beats of {len(ecg)} pulses, needed at least {MIN_BEATS}; "
            "check its cable, and that each beat gives one pulse"
        )
    if len(peaks) < MIN_BEATS and not isinstance(ecg, TriggerTimes):
        raise InvalidInputError(
            f"the ECG has {len(peaks)} R peaks in {len(ecg) / ecg.rate_hz:.0f} s on lead(s) "
            f"{', '.join(ecg.leads)}, needed at least {MIN_BEATS}; check the electrodes and the lead"
        )
