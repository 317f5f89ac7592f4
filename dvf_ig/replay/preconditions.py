"""What a recording must hold before it can be replayed: common time, tracked poses and heart beats."""

import numpy as np

from dvf_ig.cardiac import MIN_BEATS, PhaseTracking
from dvf_ig.core import FloatArray, InvalidInputError, NoOverlapError, Scenario

RATE_HZ = 1000.0


def tick_times(scenario: Scenario) -> FloatArray:
    """Every millisecond in which ECG and tool were both recorded.

    Raises:
        NoOverlapError: that is less than a second.
    """
    ecg_s = scenario.ecg.t_s
    begin = max(float(ecg_s[0]), float(scenario.tool.t_s[0]))
    end = min(float(ecg_s[-1]), float(scenario.tool.t_s[-1]))
    count = int((end - begin) * RATE_HZ)
    if count < RATE_HZ:
        raise NoOverlapError(
            f"ECG ({ecg_s[0]:.1f} to {ecg_s[-1]:.1f} s) and tool ({scenario.tool.t_s[0]:.1f} to "
            f"{scenario.tool.t_s[-1]:.1f} s) share less than a second; they must be on one clock"
        )
    return begin + np.arange(count) / RATE_HZ


def require_tracked_poses(scenario: Scenario) -> None:
    """Raise InvalidInputError where probe or tool was never tracked."""
    probe = scenario.ultrasound.stream("tracker", "probe")
    for stream, name in ((probe, "ultrasound.igs.mha"), (scenario.tool, "tool.igs.mha")):
        if not stream.valid.any():
            raise InvalidInputError(
                f"{name}: none of the {len(stream)} poses of {stream.name} has status OK; "
                "check the line of sight and record again"
            )


def require_heart_beats(phase_tracking: PhaseTracking, scenario: Scenario) -> None:
    """Raise InvalidInputError where the ECG shows too few R peaks."""
    if len(phase_tracking.peaks) < MIN_BEATS:
        ecg = scenario.ecg
        raise InvalidInputError(
            f"the ECG has {len(phase_tracking.peaks)} R peaks in {len(ecg) / ecg.rate_hz:.0f} s on lead(s) "
            f"{', '.join(ecg.leads)}, needed at least {MIN_BEATS}; check the electrodes and the lead"
        )
