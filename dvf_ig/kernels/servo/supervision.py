"""The supervisor of the force as a kernel: fades, slew limit, latch, re-arm.

`tests/oracles/readable_supervisor.py` is its readable form; tests hold one to the other step by step.
"""

import math
from typing import Any

from dvf_ig.core import FloatArray
from dvf_ig.kernels.compiled import inlined, kernel

from .layout import CLAMPS

OK = 0
DEGRADED = 1
FADE = 2
LATCHED = 3

REARMED = 1
NOT_LATCHED = 2
NO_RECENT_STEP = 3
HAZARD_ACTIVE = 4
FORCE_WANTED = 5
"""Answers to a re-arm."""


@kernel
def _begin_rise(s: Any, t_s: float) -> None:
    s.state, s.cause, s.latch_due, s.slow, s.rise_start_s = DEGRADED, 0, 0, 1, t_s


@kernel
def _begin_fade(s: Any, hazards: Any, t_s: float, duration_s: float) -> None:
    if s.state != FADE or t_s + duration_s < s.fade_end_s:
        for k in range(3):
            s.fade_from_n[k] = s.sent_n[k]
        s.fade_start_s = t_s
        sending = s.sent_n[0] != 0.0 or s.sent_n[1] != 0.0 or s.sent_n[2] != 0.0
        s.fade_end_s = t_s + duration_s if sending else t_s
        s.state = FADE
    s.cause = s.cause | (s.hazards & hazards.fading)


@kernel
def _release(s: Any, hazards: Any, t_s: float) -> None:
    if t_s < s.fade_end_s:
        gone = (t_s - s.fade_start_s) / (s.fade_end_s - s.fade_start_s)
        s.scale = 0.5 * (1.0 + math.cos(math.pi * gone))
        for k in range(3):
            s.sent_n[k] = s.scale * s.fade_from_n[k]
        return
    for k in range(3):
        s.sent_n[k] = 0.0
    if s.latch_due != 0:
        s.state, s.clamp_count = LATCHED, 0
    elif not s.hazards & hazards.fading:
        _begin_rise(s, t_s)


@inlined
def _follow(s: Any, limits: Any, hazards: Any, t_s: float, dt_s: float, wanted: FloatArray) -> None:
    risen = (t_s - s.rise_start_s) / s.rise_s if s.rise_s > 0.0 else 1.0
    scale = 0.5 * (1.0 - math.cos(math.pi * min(max(risen, 0.0), 1.0))) if risen < 1.0 else 1.0
    slow = s.slow != 0 or (s.hazards & hazards.slowing) != 0
    slew = min(limits.slow_slew_n_per_s, limits.slew_n_per_s) if slow else limits.slew_n_per_s
    largest = dt_s * slew
    x = scale * wanted[0] - s.sent_n[0]
    y = scale * wanted[1] - s.sent_n[1]
    z = scale * wanted[2] - s.sent_n[2]
    size = math.sqrt(x * x + y * y + z * z)
    cut = size > largest
    if cut:
        share = largest / size
        s.sent_n[0] += share * x
        s.sent_n[1] += share * y
        s.sent_n[2] += share * z
    else:
        for k in range(3):
            s.sent_n[k] = scale * wanted[k]
    still_slow = slow and (cut or risen < 1.0)
    s.slow = 1 if still_slow else 0
    if not still_slow:
        s.rise_s = 0.0
    s.state = DEGRADED if s.hazards != 0 or still_slow else OK
    s.scale = scale
    s.clamped = 1 if cut and not slow and dt_s > 0.0 else 0


@kernel
def _too_many_clamps(s: Any, limits: Any, t_s: float) -> bool:
    count = s.clamp_count
    s.clamps_s[count % CLAMPS] = t_s
    s.clamp_count = count + 1
    if count + 1 < CLAMPS:
        return False
    return bool(t_s - s.clamps_s[(count + 1) % CLAMPS] <= limits.clamps_within_s)


@inlined
def supervise(s: Any, limits: Any, hazards: Any, t_s: float, wanted: FloatArray, active: int) -> None:
    """One step: fills sent force, state, hazards, cause, scale and clamped of the memory.

    Args:
        s: SUPERVISION; limits: LIMITS; hazards: HAZARDS.
        t_s: not before the last step's.
        wanted: (3,) N.
        active: bits of the hazards that are active now.
    """
    dt_s = t_s - s.last_s if math.isfinite(s.last_s) else 0.0
    s.last_s = t_s
    s.wanted_n = math.sqrt(wanted[0] ** 2 + wanted[1] ** 2 + wanted[2] ** 2)
    if not math.isfinite(s.wanted_n):
        active |= hazards.not_finite
    s.hazards = active
    if active & hazards.latch_late:
        if math.isnan(s.unsafe_since_s):
            s.unsafe_since_s = t_s
        elif t_s - s.unsafe_since_s >= limits.latch_after_s:
            s.latch_due = 1
    else:
        s.unsafe_since_s = math.nan
    if active & hazards.latch_at_once:
        s.latch_due = 1
    s.scale, s.clamped = 0.0, 0
    if active & hazards.fading and s.state != LATCHED:
        duration_s = limits.fast_fade_s if active & hazards.fast else limits.fade_s
        _begin_fade(s, hazards, t_s, 0.0 if active & hazards.at_once else duration_s)
    if s.state == FADE:
        _release(s, hazards, t_s)
    elif s.state != LATCHED:
        _follow(s, limits, hazards, t_s, dt_s, wanted)
        if s.clamped != 0 and _too_many_clamps(s, limits, t_s):
            s.hazards = s.hazards | hazards.force_clamped
            s.latch_due = 1
            _begin_fade(s, hazards, t_s, limits.fade_s)


@kernel
def rearm(s: Any, limits: Any, hazards: Any, t_s: float) -> int:
    """An operator's request to leave LATCHED, judged by what the last step saw; the answer."""
    if s.state != LATCHED:
        return NOT_LATCHED
    if not t_s - s.last_s <= limits.rearm_age_s:
        return NO_RECENT_STEP
    if s.hazards & hazards.fading:
        return HAZARD_ACTIVE
    if not s.wanted_n < limits.rearm_below_n:
        return FORCE_WANTED
    s.rise_s = limits.rearm_rise_s
    _begin_rise(s, t_s)
    return REARMED
