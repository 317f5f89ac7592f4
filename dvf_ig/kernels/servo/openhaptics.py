"""An OpenHaptics device behind the two functions of `device_call`.

The vendor's scheduler owns the device: frames begin and end in its thread. A callback there, compiled and
without Python, hands positions over and takes forces under sequence locks, once a scheduler tick. A force
older than the servo's watchdog allows is replaced by zero: the scheduler would otherwise repeat it for ever,
and give it once more after the process was stopped.
"""

from typing import Any

import numpy as np
from numba import carray, core

from dvf_ig.kernels.compiled import callback

from .clock import elapsed_ns
from .foreign import call_doubles, call_error_code, call_integers, call_with_handle, device_function
from .shared import load_relaxed, publish, read_shared, store_relaxed

types: Any = core.types

HD_CURRENT_BUTTONS = 0x2000
HD_CURRENT_POSITION = 0x2050
HD_CURRENT_FORCE = 0x2700
HD_CALLBACK_CONTINUE = 1

# Offsets in its context. Locks and what they guard:
POSITION_LOCK = 0
POSITION = 8
FORCE_LOCK = 16
FORCE = 24
"""(3,) in the vendor's order, and when the servo sent it, by `elapsed_ns`."""
# Of the callback:
HANDLE = 32
BEGIN_FRAME = 33
END_FRAME = 34
GET_DOUBLES = 35
SET_DOUBLES = 36
GET_ERROR = 37
SEEN_FORCE = 38
CALLBACK_CLOCK = 39
FRAME = 41
"""(3,) numbers in the vendor's order; (4,) the force read last; (4,) of the reads."""
ERROR = 56
GET_INTEGERS = 57
BUTTONS = 58
"""Bits of the pressed buttons."""
# Of the servo's thread:
SEEN_POSITION = 64
READ_NS = 65
LAST_XYZ = 66
WORK = 72
LOST_AFTER_NS = 76
"""Without a new position for so long the device is lost."""
SENT = 80
SERVO_CLOCK = 84
CONTEXT_SIZE = 88

SILENT_AFTER_NS = 10_000_000
"""A force older than this is not given: the servo's watchdog has tripped, or will."""


@callback(types.uint32(types.voidptr))
def exchange(context: Any) -> int:
    """The scheduler's callback: position out, force in."""
    c, n = carray(context, CONTEXT_SIZE, np.int64), carray(context, CONTEXT_SIZE, np.float64)
    call_with_handle(c[BEGIN_FRAME], c[HANDLE])
    call_doubles(c[GET_DOUBLES], HD_CURRENT_POSITION, n, FRAME)
    call_integers(c[GET_INTEGERS], HD_CURRENT_BUTTONS, c, BUTTONS)
    seen = read_shared(
        c[FORCE_LOCK : FORCE_LOCK + 1],
        n[FORCE : FORCE + 4],
        c[SEEN_FORCE],
        n[FRAME + 3 : FRAME + 7],
        n[FRAME + 7 : FRAME + 11],
        4,
        0,
    )
    c[SEEN_FORCE] = seen
    error = load_relaxed(c, ERROR)
    age_ns = elapsed_ns(c[CALLBACK_CLOCK : CALLBACK_CLOCK + 2]) - n[FRAME + 6]
    if error != 0 or age_ns > SILENT_AFTER_NS:
        for k in range(3):
            n[FRAME + 3 + k] = 0.0
    call_doubles(c[SET_DOUBLES], HD_CURRENT_FORCE, n, FRAME + 3)
    call_with_handle(c[END_FRAME], c[HANDLE])
    failed = call_error_code(c[GET_ERROR])
    if failed != 0 and error == 0:
        store_relaxed(c, ERROR, failed)
    publish(c[POSITION_LOCK : POSITION_LOCK + 1], n[POSITION : POSITION + 3], n[FRAME : FRAME + 3])
    return HD_CALLBACK_CONTINUE


@device_function
def read_openhaptics(context: Any, now_ns: int, out: Any) -> int:
    """The position of the newest scheduler tick."""
    c, n = carray(context, CONTEXT_SIZE, np.int64), carray(context, CONTEXT_SIZE, np.float64)
    position = carray(out, 3)
    seen = read_shared(
        c[POSITION_LOCK : POSITION_LOCK + 1],
        n[POSITION : POSITION + 3],
        c[SEEN_POSITION],
        n[LAST_XYZ : LAST_XYZ + 3],
        n[WORK : WORK + 3],
        3,
        0,
    )
    if seen != c[SEEN_POSITION] or c[READ_NS] == 0:
        c[SEEN_POSITION], c[READ_NS] = seen, now_ns
    for k in range(3):
        position[k] = n[LAST_XYZ + k]
    lost = now_ns - c[READ_NS] > c[LOST_AFTER_NS] or load_relaxed(c, ERROR) != 0
    return 1 if lost or seen <= 0 else 0


@device_function
def write_openhaptics(context: Any, now_ns: int, force_n: Any) -> int:
    """Hand the force to the next scheduler tick."""
    c, n, force = (
        carray(context, CONTEXT_SIZE, np.int64),
        carray(context, CONTEXT_SIZE, np.float64),
        carray(force_n, 3),
    )
    for k in range(3):
        n[SENT + k] = force[k]
    n[SENT + 3] = elapsed_ns(c[SERVO_CLOCK : SERVO_CLOCK + 2])
    publish(c[FORCE_LOCK : FORCE_LOCK + 1], n[FORCE : FORCE + 4], n[SENT : SENT + 4])
    return 0 if load_relaxed(c, ERROR) == 0 else 1
