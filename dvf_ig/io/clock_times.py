"""Times of day and elapsed times as recorders write them: 30.03.2024 13:59:50.004, 01:59:50 PM, 0:02.778."""

import re

import numpy as np

from dvf_ig.core.arrays import FloatArray

DAY_S = 86400.0
_MONTH = "jan|feb|m[aä]r|apr|ma[yi]|jun|jul|aug|sep|o[ck]t|nov|de[cz]"
_DATE = (
    r"(?:\d{4}[-/.]\d{1,2}[-/.]\d{1,2}"
    rf"|\d{{1,2}}[-/. ](?:\d{{1,2}}|(?:{_MONTH})[a-zä]*)[-/. ]\d{{2,4}})"
)
_CLOCK = re.compile(
    rf"(?:({_DATE})(?:T|,? +))?(?:(\d+):)?(\d{{1,2}}):(\d{{1,2}}(?:[.,:]\d*)?)(?: ?([ap])\.?m\.?)?"
    r"(?:Z| ?[+-]\d\d:?\d\d)?",
    re.IGNORECASE,
)


def clock_seconds(text: str) -> float | None:
    """Parse seconds since midnight, or since the recording began; None if the text is not such a time."""
    match = _CLOCK.fullmatch(text)
    if match is None:
        return None
    hours, minutes, seconds = int(match[2] or 0), int(match[3]), float(re.sub("[,:]", ".", match[4]))
    if match[5] is not None:
        if not 1 <= hours <= 12:
            return None
        hours = hours % 12 + (12 if match[5].lower() == "p" else 0)
    if (minutes > 59 and match[2] is not None) or seconds >= 61.0 or (match[1] is not None and hours > 23):
        return None
    return 3600.0 * hours + 60.0 * minutes + seconds


def days_of(text: str) -> str:
    """Return the date of a time; "" if it has none."""
    match = _CLOCK.fullmatch(text)
    return "" if match is None or match[1] is None else match[1]


def past_midnight(t_s: FloatArray) -> FloatArray:
    """Unwrap (n,) times of day across midnight."""
    return np.asarray(np.unwrap(t_s, period=DAY_S))
