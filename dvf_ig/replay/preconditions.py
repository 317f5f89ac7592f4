"""Requirements on a recording that is to be replayed: common time, tracked poses and heart beats."""

from collections.abc import Sized

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, PoseStream, Scenario, TriggerTimes
from dvf_ig.intake import fit as recording_checks

RATE_HZ = 1000.0


def tick_times(scenario: Scenario) -> FloatArray:
    """Every millisecond from when ECG and tool are both recorded until the ECG, or tool and probe, end.

    With a trigger in place of the ECG, from the tool's first pose on: a trigger that is silent is no end.

    Raises:
        NoOverlapError: ECG or trigger and tool share less than a second.
    """
    beats, tool_s = scenario.ecg, tool_of(scenario).t_s
    recording_checks.require_common_time(beats, tool_s, "tool")
    begin = max(float(beats.t_s[0]), float(tool_s[0]))
    tracked_until = max(float(tool_s[-1]), float(scenario.ultrasound.t_s[-1]))
    end = min(float(beats.t_s[-1]), tracked_until)
    if isinstance(beats, TriggerTimes):
        begin, end = float(tool_s[0]), tracked_until
    return begin + np.arange(int((end - begin) * RATE_HZ)) / RATE_HZ


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
    recording_checks.require_tracked(scenario.ultrasound.stream("tracker", "probe"), "ultrasound")


def require_tracked_poses(scenario: Scenario) -> None:
    """Raise InvalidInputError where probe or tool was never tracked."""
    require_tracked_probe(scenario)
    recording_checks.require_tracked(tool_of(scenario), "tool")


def require_heart_beats(peaks: Sized, scenario: Scenario) -> None:
    """Raise InvalidInputError where the ECG shows too few R peaks."""
    recording_checks.require_heart_beats(peaks, scenario.ecg)
