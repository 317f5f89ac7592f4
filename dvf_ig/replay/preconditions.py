"""What a recording must hold before it can be replayed: common time, tracked poses and heart beats."""

from collections.abc import Sized

import numpy as np

from dvf_ig.cardiac import MIN_BEATS
from dvf_ig.core import FloatArray, InvalidInputError, NoOverlapError, PoseStream, Scenario

from .start import require_start

RATE_HZ = 1000.0


def tick_times(scenario: Scenario) -> FloatArray:
    """Every millisecond from when ECG and tool are both recorded until the ECG, or tool and probe, end.

    Raises:
        NoOverlapError: ECG and tool share less than a second.
    """
    ecg_s, tool_s = scenario.ecg.t_s, tool_of(scenario).t_s
    begin = max(float(ecg_s[0]), float(tool_s[0]))
    tracked_until = max(float(tool_s[-1]), float(scenario.ultrasound.t_s[-1]))
    end = min(float(ecg_s[-1]), tracked_until)
    count = int((end - begin) * RATE_HZ)
    if min(end, float(tool_s[-1])) - begin < 1.0:
        raise NoOverlapError(
            f"ECG ({ecg_s[0]:.1f} to {ecg_s[-1]:.1f} s) and tool ({tool_s[0]:.1f} to "
            f"{tool_s[-1]:.1f} s) share less than a second; they must be on one clock"
        )
    return begin + np.arange(count) / RATE_HZ


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
    """Raise InvalidInputError where the ECG shows too few R peaks."""
    if len(peaks) < MIN_BEATS:
        ecg = scenario.ecg
        raise InvalidInputError(
            f"the ECG has {len(peaks)} R peaks in {len(ecg) / ecg.rate_hz:.0f} s on lead(s) "
            f"{', '.join(ecg.leads)}, needed at least {MIN_BEATS}; check the electrodes and the lead"
        )
