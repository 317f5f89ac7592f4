"""The supervisor of the force as a kernel: fades, slew limit, latch, re-arm.

`dvf_ig.guidance.supervision.supervisor.Supervisor` is its readable form; tests hold one to the other step by
step.
"""

import math
from typing import Any

from dvf_ig.core import FloatArray
from dvf_ig.kernels.compiled import kernel

OK = 0
DEGRADED = 1
FADE = 2
LATCHED = 3

# Offsets in the supervisor's memory.
STATE = 0
SENT = 1
LAST_S = 4
WANTED_N = 5
HAZARDS = 6
CAUSE = 7
SLOW = 8
LATCH_DUE = 9
UNSAFE_SINCE_S = 10
FADE_FROM = 11
FADE_START_S = 14
FADE_END_S = 15
RISE_S = 16
RISE_START_S = 17
SCALE = 18
CLAMPED = 19
CLAMP_COUNT = 20
CLAMPS_S = 21
CLAMPS = 10
MEMORY_SIZE = CLAMPS_S + CLAMPS

# Offsets in its limits.
FADE_S = 0
FAST_FADE_S = 1
SLEW = 2
SLOW_SLEW = 3
LATCH_AFTER_S = 4
CLAMPS_WITHIN_S = 5
REARM_BELOW_N = 6
REARM_RISE_S = 7
REARM_AGE_S = 8
LIMITS_SIZE = 9

# Offsets in the hazards' masks, each a sum of hazard bits.
FADING = 0
FAST = 1
AT_ONCE = 2
SLOWING = 3
LATCH_LATE = 4
LATCH_AT_ONCE = 5
NOT_FINITE = 6
FORCE_CLAMPED = 7
MASKS_SIZE = 8

REARMED = 1
NOT_LATCHED = 2
NO_RECENT_STEP = 3
HAZARD_ACTIVE = 4
FORCE_WANTED = 5
"""Answers to a re-arm."""


@kernel
def start_supervision(s: FloatArray) -> None:
    """Memory before the first step."""
    s[:] = 0.0
    s[STATE], s[SLOW] = DEGRADED, 1.0
    s[LAST_S] = s[UNSAFE_SINCE_S] = math.nan
    s[WANTED_N] = math.inf


@kernel
def _begin_rise(s: FloatArray, t_s: float) -> None:
    s[STATE], s[CAUSE], s[LATCH_DUE], s[SLOW], s[RISE_START_S] = DEGRADED, 0.0, 0.0, 1.0, t_s


@kernel
def _begin_fade(s: FloatArray, masks: Any, t_s: float, duration_s: float) -> None:
    if s[STATE] != FADE or t_s + duration_s < s[FADE_END_S]:
        for k in range(3):
            s[FADE_FROM + k] = s[SENT + k]
        s[FADE_START_S] = t_s
        sending = s[SENT] != 0.0 or s[SENT + 1] != 0.0 or s[SENT + 2] != 0.0
        s[FADE_END_S] = t_s + duration_s if sending else t_s
        s[STATE] = FADE
    s[CAUSE] = float(int(s[CAUSE]) | (int(s[HAZARDS]) & masks[FADING]))


@kernel
def _release(s: FloatArray, masks: Any, t_s: float) -> None:
    if t_s < s[FADE_END_S]:
        gone = (t_s - s[FADE_START_S]) / (s[FADE_END_S] - s[FADE_START_S])
        s[SCALE] = 0.5 * (1.0 + math.cos(math.pi * gone))
        for k in range(3):
            s[SENT + k] = s[SCALE] * s[FADE_FROM + k]
        return
    for k in range(3):
        s[SENT + k] = 0.0
    if s[LATCH_DUE] != 0.0:
        s[STATE], s[CLAMP_COUNT] = LATCHED, 0.0
    elif not int(s[HAZARDS]) & masks[FADING]:
        _begin_rise(s, t_s)


@kernel
def _follow(
    s: FloatArray, limits: FloatArray, masks: Any, t_s: float, dt_s: float, wanted: FloatArray
) -> None:
    bits = int(s[HAZARDS])
    risen = (t_s - s[RISE_START_S]) / s[RISE_S] if s[RISE_S] > 0.0 else 1.0
    scale = 0.5 * (1.0 - math.cos(math.pi * min(max(risen, 0.0), 1.0))) if risen < 1.0 else 1.0
    slow = s[SLOW] != 0.0 or (bits & masks[SLOWING]) != 0
    largest = dt_s * (min(limits[SLOW_SLEW], limits[SLEW]) if slow else limits[SLEW])
    x, y, z = scale * wanted[0] - s[SENT], scale * wanted[1] - s[SENT + 1], scale * wanted[2] - s[SENT + 2]
    size = math.sqrt(x * x + y * y + z * z)
    cut = size > largest
    if cut:
        share = largest / size
        s[SENT] += share * x
        s[SENT + 1] += share * y
        s[SENT + 2] += share * z
    else:
        for k in range(3):
            s[SENT + k] = scale * wanted[k]
    still_slow = slow and (cut or risen < 1.0)
    s[SLOW] = 1.0 if still_slow else 0.0
    if not still_slow:
        s[RISE_S] = 0.0
    s[STATE] = DEGRADED if bits != 0 or still_slow else OK
    s[SCALE] = scale
    s[CLAMPED] = 1.0 if cut and not slow and dt_s > 0.0 else 0.0


@kernel
def _too_many_clamps(s: FloatArray, limits: FloatArray, t_s: float) -> bool:
    count = int(s[CLAMP_COUNT])
    s[CLAMPS_S + count % CLAMPS] = t_s
    s[CLAMP_COUNT] = count + 1.0
    if count + 1 < CLAMPS:
        return False
    first = s[CLAMPS_S + (count + 1) % CLAMPS]
    return bool(t_s - first <= limits[CLAMPS_WITHIN_S])


@kernel
def supervise(
    s: FloatArray, limits: FloatArray, masks: Any, t_s: float, wanted: FloatArray, hazards: int
) -> None:
    """One step: fills SENT, STATE, HAZARDS, CAUSE, SCALE and CLAMPED of the memory.

    Args:
        s: memory (`start_supervision`).
        limits, masks: constants at the offsets of this module; masks int64.
        t_s: not before the last step's.
        wanted: (3,) N.
        hazards: bits that are active now.
    """
    dt_s = t_s - s[LAST_S] if math.isfinite(s[LAST_S]) else 0.0
    s[LAST_S] = t_s
    s[WANTED_N] = math.sqrt(wanted[0] ** 2 + wanted[1] ** 2 + wanted[2] ** 2)
    if not math.isfinite(s[WANTED_N]):
        hazards |= masks[NOT_FINITE]
    s[HAZARDS] = float(hazards)
    if hazards & masks[LATCH_LATE]:
        if math.isnan(s[UNSAFE_SINCE_S]):
            s[UNSAFE_SINCE_S] = t_s
        elif t_s - s[UNSAFE_SINCE_S] >= limits[LATCH_AFTER_S]:
            s[LATCH_DUE] = 1.0
    else:
        s[UNSAFE_SINCE_S] = math.nan
    if hazards & masks[LATCH_AT_ONCE]:
        s[LATCH_DUE] = 1.0
    s[SCALE] = s[CLAMPED] = 0.0
    if hazards & masks[FADING] and s[STATE] != LATCHED:
        fast = limits[FAST_FADE_S] if hazards & masks[FAST] else limits[FADE_S]
        _begin_fade(s, masks, t_s, 0.0 if hazards & masks[AT_ONCE] else fast)
    if s[STATE] == FADE:
        _release(s, masks, t_s)
    elif s[STATE] != LATCHED:
        _follow(s, limits, masks, t_s, dt_s, wanted)
        if s[CLAMPED] != 0.0 and _too_many_clamps(s, limits, t_s):
            s[HAZARDS] = float(int(s[HAZARDS]) | masks[FORCE_CLAMPED])
            s[LATCH_DUE] = 1.0
            _begin_fade(s, masks, t_s, limits[FADE_S])


@kernel
def rearm(s: FloatArray, limits: FloatArray, masks: Any, t_s: float) -> int:
    """An operator's request to leave LATCHED, judged by what the last step saw; the answer."""
    if s[STATE] != LATCHED:
        return NOT_LATCHED
    if not t_s - s[LAST_S] <= limits[REARM_AGE_S]:
        return NO_RECENT_STEP
    if int(s[HAZARDS]) & masks[FADING]:
        return HAZARD_ACTIVE
    if not s[WANTED_N] < limits[REARM_BELOW_N]:
        return FORCE_WANTED
    s[RISE_S] = limits[REARM_RISE_S]
    _begin_rise(s, t_s)
    return REARMED
