"""Hand on a haptic device, free or through a fulcrum, behind the two C functions of a servo's device.

    int32 read(void *context, int64 now_ns, double *tip_mm)         int32 write(…, const double *tip_force_n)

Mass m of hand and device; stiffness K, damping B of the hand about its intended position p:

    m a = K (p − x) − (B + b) v + push + Jᵀ F − dry friction,       J = ∂tip/∂x

Without a fulcrum tip = x. With one, an instrument of length L passes through the fixed point P: with
r = |x − P| and u = (x − P)/r, tip = P − (L − r) u, hence J = u uᵀ − (L − r)/r (I − u uᵀ): sideways motion is
inverted and scaled by the lever (L − r)/r, and the force at the hand is Jᵀ F (virtual work).
"""

import math
from typing import Any

import numpy as np
from numba import carray, core

from .compiled import callback, kernel

# Offsets in the context, float64 numbers in an int64 array.
HAND_MM = 0
HAND_MM_S = 3
FORCE_N = 6
"""Force at the tip, acting now."""
FELT_N = 9
"""Force at the hand, due to the force acting now."""
LAST_S = 12
MASS_KG = 13
STIFFNESS_N_PER_MM = 14
DAMPING_N_S_PER_MM = 15
VISCOUS_N_S_PER_MM = 16
DRY_N = 17
LARGEST_N = 18
RESOLUTION_MM = 19
DELAY_S = 20
PLACE_MM = 21
PUSH_N = 24
LENGTH_MM = 27
"""0: no fulcrum."""
FULCRUM_MM = 28
QUEUED = 31
QUEUE = 32
QUEUE_LENGTH = 128
CONTEXT_SIZE = QUEUE + 4 * QUEUE_LENGTH
"""Size of the context. The queue holds delayed forces: start of action (s), and 3 numbers in N."""

STEP_S = 1e-4
LONGEST_S = 0.1
"""Longest silence of the servo that is caught up with."""
MM_PER_M = 1000.0

_types: Any = core.types
_device_function = callback(_types.int32(_types.voidptr, _types.int64, _types.CPointer(_types.float64)))


@kernel(error_model="numpy")
def tip_of(x: Any, y: Any, z: Any, length_mm: float, fulcrum_mm: Any) -> Any:
    """Compute the tip's coordinates from the hand's."""
    if length_mm <= 0.0:
        return x, y, z
    dx, dy, dz = x - fulcrum_mm[0], y - fulcrum_mm[1], z - fulcrum_mm[2]
    r = math.sqrt(dx * dx + dy * dy + dz * dz)
    share = (length_mm - r) / r
    return fulcrum_mm[0] - share * dx, fulcrum_mm[1] - share * dy, fulcrum_mm[2] - share * dz


@kernel(error_model="numpy")
def force_at_hand(hand_mm: Any, fx: float, fy: float, fz: float, length_mm: float, fulcrum_mm: Any) -> Any:
    """Jᵀ F."""
    if length_mm <= 0.0:
        return fx, fy, fz
    dx, dy, dz = hand_mm[0] - fulcrum_mm[0], hand_mm[1] - fulcrum_mm[1], hand_mm[2] - fulcrum_mm[2]
    square = dx * dx + dy * dy + dz * dz
    lever = length_mm / math.sqrt(square) - 1.0
    along = (1.0 + lever) * (fx * dx + fy * dy + fz * dz) / square
    return along * dx - lever * fx, along * dy - lever * fy, along * dz - lever * fz


@kernel(error_model="numpy")
def move(d: Any, h: float) -> None:
    """Advance one sub-step: springs and pushes explicit, damping implicit, dry friction at most stops."""
    fulcrum = d[FULCRUM_MM : FULCRUM_MM + 3]
    felt = force_at_hand(d, d[FORCE_N], d[FORCE_N + 1], d[FORCE_N + 2], d[LENGTH_MM], fulcrum)
    push = h * MM_PER_M / d[MASS_KG]
    slowed = 1.0 / (1.0 + push * (d[DAMPING_N_S_PER_MM] + d[VISCOUS_N_S_PER_MM]))
    square = 0.0
    for k in range(3):
        d[FELT_N + k] = felt[k]
        force = felt[k] + d[PUSH_N + k] + d[STIFFNESS_N_PER_MM] * (d[PLACE_MM + k] - d[HAND_MM + k])
        d[HAND_MM_S + k] = slowed * (d[HAND_MM_S + k] + push * force)
        square += d[HAND_MM_S + k] ** 2
    speed, stopped = math.sqrt(square), slowed * push * d[DRY_N]
    share = 1.0 - stopped / speed if speed > stopped else 0.0
    for k in range(3):
        d[HAND_MM_S + k] *= share
        d[HAND_MM + k] += h * d[HAND_MM_S + k]


@_device_function
def read_instrument(context: Any, now_ns: int, out: Any) -> int:
    """Advance until now, then measure at the hand and compute the tip."""
    d, tip = carray(context, CONTEXT_SIZE, np.float64), carray(out, 3)
    now_s = now_ns * 1e-9
    if d[LAST_S] == 0.0:
        d[LAST_S] = now_s
    left = min(now_s - d[LAST_S], LONGEST_S)
    at = now_s - left
    steps = int(left / STEP_S + 1.0 - 1e-6)
    h = left / steps if steps > 0 else 0.0
    for _ in range(steps):
        at += h
        while d[QUEUED] > 0.0 and d[QUEUE] <= at - 0.5 * h:
            for k in range(3):
                d[FORCE_N + k] = d[QUEUE + 1 + k]
            d[QUEUED] -= 1.0
            for i in range(4 * int(d[QUEUED])):
                d[QUEUE + i] = d[QUEUE + 4 + i]
        move(d, h)
    d[LAST_S] = now_s
    x, y, z, step = d[HAND_MM], d[HAND_MM + 1], d[HAND_MM + 2], d[RESOLUTION_MM]
    if step > 0.0:
        x, y, z = round(x / step) * step, round(y / step) * step, round(z / step) * step
    tip[0], tip[1], tip[2] = tip_of(x, y, z, d[LENGTH_MM], d[FULCRUM_MM : FULCRUM_MM + 3])
    return 0


@_device_function
def write_instrument(context: Any, now_ns: int, force_n: Any) -> int:
    """Accept a force at the tip; it reaches the hand limited to the device's, after its delay."""
    d, force = carray(context, CONTEXT_SIZE, np.float64), carray(force_n, 3)
    fulcrum = d[FULCRUM_MM : FULCRUM_MM + 3]
    hx, hy, hz = force_at_hand(d, force[0], force[1], force[2], d[LENGTH_MM], fulcrum)
    size = math.sqrt(hx * hx + hy * hy + hz * hz)
    if not math.isfinite(size) or d[QUEUED] >= QUEUE_LENGTH:
        return 1
    share = min(1.0, d[LARGEST_N] / size) if size > 0.0 else 1.0
    at = QUEUE + 4 * int(d[QUEUED])
    d[at] = now_ns * 1e-9 + d[DELAY_S]
    for k in range(3):
        d[at + 1 + k] = share * force[k]
    d[QUEUED] += 1.0
    return 0
