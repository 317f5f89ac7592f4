"""What recordings must hold before they are of use: poses that were tracked, common time, heart beats."""

from collections.abc import Sized

from dvf_ig.cardiac import MIN_BEATS
from dvf_ig.core import FloatArray, InvalidInputError, NoOverlapError, PoseStream, Signal

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


def require_common_time(ecg_s: FloatArray, other_s: FloatArray, what: str) -> None:
    """Raise NoOverlapError where the ECG and another recording share less than LEAST_COMMON_S.

    Args:
        ecg_s, other_s: (n,) and (m,) increasing times.
        what: the other is, for example "tool".
    """
    if not have_common_time(ecg_s, other_s):
        raise NoOverlapError(
            f"ECG ({ecg_s[0]:.1f} to {ecg_s[-1]:.1f} s) and {what} ({other_s[0]:.1f} to "
            f"{other_s[-1]:.1f} s) share less than a second; they must be on one clock"
        )


def require_heart_beats(peaks: Sized, ecg: Signal) -> None:
    """Raise InvalidInputError where the ECG shows too few R peaks."""
    if len(peaks) < MIN_BEATS:
        raise InvalidInputError(
            f"the ECG has {len(peaks)} R peaks in {len(ecg) / ecg.rate_hz:.0f} s on lead(s) "
            f"{', '.join(ecg.leads)}, needed at least {MIN_BEATS}; check the electrodes and the lead"
        )
