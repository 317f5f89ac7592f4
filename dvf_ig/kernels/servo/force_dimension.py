"""A Force Dimension device behind the two functions of `device_call`; the SDK speaks metres."""

from typing import Any

import numpy as np
from numba import carray

from .foreign import call_get_button, call_get_position, call_set_force, device_function

# Offsets in its context.
GET_POSITION = 0
SET_FORCE = 1
DEVICE = 2
SCRATCH = 3
GET_BUTTON = 6
PRESSED = 7
READS = 8
CONTEXT_SIZE = 9
READS_PER_BUTTON = 32
"""The button is read with every 32nd position: a person presses it for 0.1 s and longer."""
MM_PER_M = 1000.0


@device_function
def read_force_dimension(context: Any, now_ns: int, out: Any) -> int:
    """dhdGetPosition: negative on an error; DHD_TIMEGUARD says that the last position still holds."""
    c, numbers, position = (
        carray(context, CONTEXT_SIZE, np.int64),
        carray(context, CONTEXT_SIZE, np.float64),
        carray(out, 3),
    )
    if call_get_position(c[GET_POSITION], numbers, SCRATCH, c[DEVICE]) < 0:
        return 1
    for k in range(3):
        position[k] = MM_PER_M * numbers[SCRATCH + k]
    if c[READS] % READS_PER_BUTTON == 0:
        c[PRESSED] = call_get_button(c[GET_BUTTON], c[DEVICE])
    c[READS] += 1
    return 0


@device_function
def write_force_dimension(context: Any, now_ns: int, force_n: Any) -> int:
    """dhdSetForce: negative on an error; DHD_MOTOR_SATURATED is none."""
    c, force = carray(context, CONTEXT_SIZE, np.int64), carray(force_n, 3)
    return 1 if call_set_force(c[SET_FORCE], force[0], force[1], force[2], c[DEVICE]) < 0 else 0
