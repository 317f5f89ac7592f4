"""A simulated haptic device behind the two functions of `device_call`: it moves in the loop's own time."""

import math
from typing import Any

import numpy as np
from numba import carray

from dvf_ig.kernels.device import advance

from .foreign import device_function

# Offsets in its context, float64 numbers in an int64 array.
STATE = 0
FORCE = 6
LAST_NS = 9
MASS_KG = 10
VISCOUS = 11
DRY_N = 12
LARGEST_N = 13
STEP_S = 14
RESOLUTION_MM = 15
DELAY_S = 16
HAND_N = 17
HAND_MM = 20
HAND_STIFFNESS = 23
HAND_DAMPING = 24
QUEUED = 25
QUEUE = 26
QUEUE_LENGTH = 64
CONTEXT_SIZE = QUEUE + 4 * QUEUE_LENGTH
"""The queue holds forces on their way: when each begins to act (s), and 3 numbers in N."""
SLOWEST_S = 0.1
"""A device that was not asked for longer stands still meanwhile: a simulation does not catch up for ever."""


@device_function
def read_simulated(context: Any, now_ns: int, out: Any) -> int:
    """Move until now under the forces sent and the hand, then measure."""
    d = carray(context, CONTEXT_SIZE, np.float64)
    position = carray(out, 3)
    now_s = now_ns * 1e-9
    if d[LAST_NS] == 0.0:
        d[LAST_NS] = now_s
    left = min(now_s - d[LAST_NS], SLOWEST_S)
    at = now_s - left
    steps = int(left / d[STEP_S] + 1.0 - 1e-6)
    h = left / steps if steps > 0 else 0.0
    force = np.empty(3)
    for _ in range(steps):
        at += h
        while d[QUEUED] > 0.0 and d[QUEUE] <= at - 0.5 * h:
            for k in range(3):
                d[FORCE + k] = d[QUEUE + 1 + k]
            d[QUEUED] -= 1.0
            for i in range(4 * int(d[QUEUED])):
                d[QUEUE + i] = d[QUEUE + 4 + i]
        for k in range(3):
            spring = d[HAND_STIFFNESS] * (d[HAND_MM + k] - d[STATE + k])
            force[k] = d[FORCE + k] + d[HAND_N + k] + spring - d[HAND_DAMPING] * d[STATE + 3 + k]
        advance(d, force, d[MASS_KG], d[VISCOUS], d[DRY_N], 1e9, h, 1, d)
    d[LAST_NS] = now_s
    for k in range(3):
        step = d[RESOLUTION_MM]
        position[k] = round(d[STATE + k] / step) * step if step > 0.0 else d[STATE + k]
    return 0


@device_function
def write_simulated(context: Any, now_ns: int, force_n: Any) -> int:
    """Take a force; it acts after the device's delay."""
    d = carray(context, CONTEXT_SIZE, np.float64)
    force = carray(force_n, 3)
    size = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    if not math.isfinite(size) or d[QUEUED] >= QUEUE_LENGTH:
        return 1
    share = min(1.0, d[LARGEST_N] / size) if size > 0.0 else 1.0
    at = QUEUE + 4 * int(d[QUEUED])
    d[at] = now_ns * 1e-9 + d[DELAY_S]
    for k in range(3):
        d[at + 1 + k] = share * force[k]
    d[QUEUED] += 1.0
    return 0
