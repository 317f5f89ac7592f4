"""What recordings must hold before they are of use: poses that were tracked, common time, heart beats."""

from collections.abc import Sized

from dvf_ig.cardiac import MIN_BEATS
from dvf_ig.core import FloatArray, InvalidInputError, NoOverlapError, PoseStream, Signal, TriggerTimes

LEAST_COMMON_S = 1.0


def require_tracked(stream: PoseStream, what: str) -> None:
    """Raise InvalidInputError where not one pose is valid.

    Args:
        what: was recorded, for example "tool".
    """
    if not stream.valid.any():
        raise InvalidInputError(
            f"{what} recording: none of the {len(stream)} poses of {stream.name} has status OK; "
            "check the line of sight and record again"
        )


def have_common_time(first_s: FloatArray, second_s: FloatArray) -> bool:
    """Whether two recordings share at least LEAST_COMMON_S, by their (n,) and (m,) increasing times."""
    begin, end = max(float(first_s[0]), float(second_s[0])), min(float(first_s[-1]), float(second_s[-1]))
    return end - begin >= LEAST_COMMON_S


def require_common_time(beats: Signal | TriggerTimes, other_s: FloatArray, what: str) -> None:
    """Raise NoOverlapError where the ECG, or a trigger, and another recording share less than LEAST_COMMON_S.

    Args:
        other_s: (n,) increasing times.
        what: the other is, for example "tool".
    """
    ecg_s = beats.t_s
    if not have_common_time(ecg_s, other_s):
        source = "trigger" if isinstance(beats, TriggerTimes) else "ECG"
        raise NoOverlapError(
            f"{source} ({ecg_s[0]:.1f} to {ecg_s[-1]:.1f} s) and {what} ({other_s[0]:.1f} to "
            f"{other_s[-1]:.1f} s) share less than a second; they must be on one clock"
        )


def require_heart_beats(peaks: Sized, ecg: Signal | TriggerTimes) -> None:
    """Raise InvalidInputError where ECG or trigger shows too few R peaks."""
    if len(peaks) >= MIN_BEATS:
        return
    if isinstance(ecg, TriggerTimes):
        raise InvalidInputError(
            f"the trigger gives {len(peaks)} beats of {len(ecg)} pulses, needed at least {MIN_BEATS}; "
            "check its cable, and that each beat gives one pulse"
        )
    raise InvalidInputError(
        f"the ECG has {len(peaks)} R peaks in {len(ecg) / ecg.rate_hz:.0f} s on lead(s) "
        f"{', '.join(ecg.leads)}, needed at least {MIN_BEATS}; check the electrodes and the lead"
    )
