"""R peaks from the trigger output of a monitor or scanner instead of an ECG."""

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError

from .rpeak import RPeak

LONGEST_DELAY_S = 0.5
SHORTEST_INTERVAL_S = 0.2
"""Two pulses closer than this cannot be two heart beats (300 per minute)."""


def trigger_peaks(t_s: FloatArray, fixed_delay_s: float = 0.0) -> tuple[RPeak, ...]:
    """R peaks from trigger pulses.

    Args:
        t_s: (n,) times of the pulses, increasing, in the time base in which phase is wanted.
        fixed_delay_s: how long after the R peak the device fires; measure it once, it does not change.
    Returns:
        one R peak a pulse, `fixed_delay_s` before it and detected when it fires.
    Raises:
        InvalidInputError: no pulse, times that are not finite or do not increase, pulses less than 0.2 s
            apart, or a delay outside 0 to 0.5 s.
    """
    times = np.asarray(t_s, dtype=np.float64)
    if times.ndim != 1 or len(times) == 0 or not np.isfinite(times).all():
        raise InvalidInputError(
            f"trigger times have shape {times.shape} or are not finite; needed (n,) seconds, n at least 1"
        )
    if not 0.0 <= fixed_delay_s <= LONGEST_DELAY_S:
        raise InvalidInputError(
            f"the trigger's delay is {fixed_delay_s:g} s; needed 0 to {LONGEST_DELAY_S:g} s "
            "after R (is it in ms?)"
        )
    gaps = np.diff(times)
    if len(gaps) and gaps.min() < SHORTEST_INTERVAL_S:
        k = int(gaps.argmin())
        raise InvalidInputError(
            f"trigger {k + 1} at {times[k + 1]:.3f} s comes {gaps[k]:.3f} s after the one before; needed at "
            f"least {SHORTEST_INTERVAL_S:g} s: order the pulses, and keep one edge of each"
        )
    return tuple(RPeak(float(t) - fixed_delay_s, float(t), 1.0) for t in times)
