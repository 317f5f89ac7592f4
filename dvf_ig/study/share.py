"""A share of trials with its Wilson 95 % interval.

Source: Wilson 1927.
"""

import math
from dataclasses import dataclass

from scipy.stats import norm


@dataclass(frozen=True, slots=True)
class Share:
    """`count` of `of`, with its Wilson 95 % interval; share and interval are None of nothing."""

    count: int
    of: int
    share: float | None
    low: float | None
    high: float | None


def share_of(count: int, of: int, independent: int | None = None) -> Share:
    """A share and its Wilson 95 % interval.

    Args:
        independent: number of trials that varied independently; all without.
    """
    if of == 0:
        return Share(0, 0, None, None, None)
    n, share, z2 = independent or of, count / of, float(norm.ppf(0.975)) ** 2
    middle = (share + z2 / (2 * n)) / (1 + z2 / n)
    half = math.sqrt(z2 * (share * (1 - share) / n + z2 / (4 * n**2))) / (1 + z2 / n)
    return Share(count, of, share, max(0.0, middle - half), min(1.0, middle + half))
