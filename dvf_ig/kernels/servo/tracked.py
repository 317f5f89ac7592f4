"""A tool that a tracker sees behind the two functions of `device_call`: its tip moves on between two poses.

A session publishes tip and velocity under a sequence lock; the servo's thread reads them and takes the tip to
now. Forces go nowhere from here: they are in the servo's record.
"""

import math
from typing import Any

import numpy as np
from numba import carray

from dvf_ig.core import FloatArray

from .device_call import device_function
from .shared import publish, read_shared

# Offsets in its context: the lock, what it guards, and what the servo's thread has read.
LOCK = 0
TIP = 8
"""(3,) mm, (3,) mm/s, and by the machine's monotonic clock the time of both, s."""
TIP_SIZE = 7
SEEN = 16
READ = 24
WORK = 32
LEFT = 40
"""(3,) mm by which the position lies off the newest prediction, (3,) the one given last, and its time."""
CONTEXT_SIZE = 48
SMOOTHED_S = 0.005
"""Where a new pose lies off the old one's prediction, the position goes over to it with this time constant: a
step of 0.3 mm would be one of 0.1 N, as much as the slew limit lets through in a tick."""
FARTHEST_MM = 3.0
"""A tip that is further off is where the new pose says."""
LONGEST_S = 0.05
"""A tip is predicted no further than this beyond its time; the session tells in time that it is lost."""


@device_function
def read_tracked(context: Any, now_ns: int, out: Any) -> int:
    """The tip now; the origin before the first one, when no session has spoken and no force is given."""
    c, n = carray(context, CONTEXT_SIZE, np.int64), carray(context, CONTEXT_SIZE, np.float64)
    position = carray(out, 3)
    read, left = n[READ : READ + TIP_SIZE], n[LEFT : LEFT + 7]
    before, now_s = c[SEEN], now_ns * 1e-9
    c[SEEN] = read_shared(
        c[LOCK : LOCK + 1], n[TIP : TIP + TIP_SIZE], c[SEEN], read, n[WORK : WORK + TIP_SIZE]
    )
    ahead_s = min(max(now_s - read[6], 0.0), LONGEST_S)
    size = 0.0
    for k in range(3):
        position[k] = read[k] + ahead_s * read[3 + k]
        if c[SEEN] != before:
            left[k] = left[3 + k] + (now_s - left[6]) * read[3 + k] - position[k]
        size += left[k] * left[k]
    share = math.exp(-(now_s - left[6]) / SMOOTHED_S) if size <= FARTHEST_MM * FARTHEST_MM else 0.0
    for k in range(3):
        left[k] *= share
        position[k] += left[k]
        left[3 + k] = position[k]
    left[6] = now_s
    return 0


@device_function
def write_tracked(context: Any, now_ns: int, force_n: Any) -> int:
    """Nothing renders the force here."""
    return 0


def publish_tip(context: Any, tip: FloatArray) -> None:
    """Tell the servo's thread where the tip is.

    Args:
        context: (CONTEXT_SIZE,) int64.
        tip: (TIP_SIZE,).
    """
    publish(context[LOCK : LOCK + 1], context.view(np.float64)[TIP : TIP + TIP_SIZE], tip)
