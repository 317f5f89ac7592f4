"""Excursions of a depth beyond a limit."""

import numpy as np

from dvf_ig.core import FloatArray

BACK_MM = 0.2
"""An excursion ends so far on this side of the limit: tremor and sensor steps do not divide it."""


def count_excursions(depth_mm: FloatArray, limit_mm: float) -> int:
    """How often the depth (n,) passes the limit; one excursion lasts until the depth is BACK_MM less."""
    beyond = np.where(depth_mm > limit_mm, 1, np.where(depth_mm < limit_mm - BACK_MM, -1, 0))
    marks = beyond[beyond != 0]
    starts = np.flatnonzero(np.diff(np.concatenate([[-1], marks])) == 2)
    return len(starts)
