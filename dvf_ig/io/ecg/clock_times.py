"""Times of day and elapsed times as recorders write them: 13:59:50.004, 0:02.778, 2026-03-04T13:59:50Z."""

import re

import numpy as np

from dvf_ig.core.arrays import FloatArray

DAY_S = 86400.0
_CLOCK = re.compile(
    r"(?:\d{4}-\d\d-\d\d[T ])?(?:(\d+):)?(\d{1,2}):(\d{1,2}(?:[.,]\d*)?)(?:Z|[+-]\d\d:?\d\d)?"
)


def clock_seconds(text: str) -> float | None:
    """Parse seconds since midnight, or since the recording began; None if the text is not such a time."""
    match = _CLOCK.fullmatch(text)
    if match is None:
        return None
    hours, minutes, seconds = match.groups(default="0")
    return 3600.0 * int(hours) + 60.0 * int(minutes) + float(seconds.replace(",", "."))


def past_midnight(t_s: FloatArray) -> FloatArray:
    """Unwrap (n,) times of day across midnight."""
    return np.asarray(np.unwrap(t_s, period=DAY_S))
