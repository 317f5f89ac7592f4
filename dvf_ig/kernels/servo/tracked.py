"""The servo's ticks in a session's own time, for a tracked tool whose tip moves on between two poses."""

import math
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.kernels.compiled import inlined, kernel
from dvf_ig.kernels.place import phase_at

from .borrowed import placed
from .layout import INPUT_WORDS, WARPS_NUMBER_WORD
from .tick import servo_tick

SMOOTHED_S = 0.005
"""Where a new pose lies off the old one's prediction, the position goes over to it with this time constant: a
step of 0.3 mm would be one of 0.1 N, as much as the slew limit lets through in a tick."""
FARTHEST_MM = 3.0
"""A tip that is further off is where the new pose says."""
LONGEST_S = 0.05
"""A tip is predicted no further than this beyond its time; the session tells in time that it is lost."""
MOST_TICKS = 2000
"""Ticks between two publications: by then a silent session's force has faded and is latched."""

TRACKED = np.dtype(
    [
        ("tip_mm", np.float64, (3,)),
        ("velocity_mm_s", np.float64, (3,)),
        ("tip_s", np.float64),
        ("fresh", np.int64),
        ("off_mm", np.float64, (3,)),
        ("last_mm", np.float64, (3,)),
        ("last_s", np.float64),
        ("model_phase", np.float64),
    ]
)
"""Tip and velocity at a time, as published; by how much the position lies off their prediction; the position
that was given last. `model_phase` is that of the last tick's time, NaN if it is not known."""


@inlined
def publish_tip(tool: Any, tip_mm: FloatArray, velocity_mm_s: FloatArray, t_s: float) -> None:
    """Take a new tip (3,) and its velocity at a time."""
    for k in range(3):
        tool.tip_mm[k], tool.velocity_mm_s[k] = tip_mm[k], velocity_mm_s[k]
    tool.tip_s, tool.fresh = t_s, 1


@inlined
def tip_at(tool: Any, t_s: float, out: FloatArray) -> bool:
    """The tip (3,) at a time not before the last, the origin before the first; whether it jumped there."""
    ahead_s = min(max(t_s - tool.tip_s, 0.0), LONGEST_S)
    size = 0.0
    for k in range(3):
        out[k] = tool.tip_mm[k] + ahead_s * tool.velocity_mm_s[k]
        if tool.fresh != 0:
            tool.off_mm[k] = tool.last_mm[k] + (t_s - tool.last_s) * tool.velocity_mm_s[k] - out[k]
        size += tool.off_mm[k] * tool.off_mm[k]
    jumped = size > FARTHEST_MM * FARTHEST_MM
    share = 0.0 if jumped else math.exp(-(t_s - tool.last_s) / SMOOTHED_S)
    for k in range(3):
        tool.off_mm[k] *= share
        out[k] += tool.off_mm[k]
        tool.last_mm[k] = out[k]
    tool.fresh, tool.last_s = 0, t_s
    return jumped


@kernel
def tick_until(
    bound: Any,
    scratch: Any,
    tool: Any,
    published: Any,
    tip_mm: FloatArray,
    velocity_mm_s: FloatArray,
    tip_seen: bool,
    now_s: float,
) -> None:
    """Ticks a period apart with what was published before, and one at `now_s` with what is published now.

    So a force at any time rests on all that is known then, and the forces between two publications on nothing
    that came later. The servo's clock is the session's.

    Args:
        bound, scratch: `Bound` and `Scratch` of `layout`; the record of the last tick is in `scratch.row`.
        tool: TRACKED.
        published: words of `Published`, of now.
        tip_mm, velocity_mm_s: (3,) of the tool now, if `known`.
    """
    bound_at, scratch_at = placed(bound), placed(scratch)
    period_s, inputs, m = bound.settings[0].period_s, scratch.inputs[0], scratch.memory[0]
    xyz, force = scratch.vectors[5], scratch.vectors[6]
    at_s, ticks, last = m.last_tick_s + period_s, 0, False
    while not last:
        # also at the first tick, whose last is NaN
        last = not at_s < now_s - 0.5 * period_s or ticks == MOST_TICKS
        if last:
            at_s = now_s
            same = published[WARPS_NUMBER_WORD] == scratch.input_words[WARPS_NUMBER_WORD]
            for k in range(INPUT_WORDS if same else len(published)):
                scratch.input_words[k] = published[k]
            if tip_seen:
                publish_tip(tool, tip_mm, velocity_mm_s, now_s)
        if tip_at(tool, at_s, xyz):
            # no motion of the tool: no speed, and no work on the hand
            m.tool_known = m.passivity.started = 0
            m.tool_mm_s[0] = m.tool_mm_s[1] = m.tool_mm_s[2] = 0.0
        servo_tick(bound_at, scratch_at, inputs, xyz, 0, at_s, 0, force)
        at_s += period_s
        ticks += 1
    of = inputs.pose_and_phase
    known_phase = of.phase_since_s <= now_s and now_s <= of.phase_until_s
    tool.model_phase = phase_at(of, now_s)[0] if known_phase else math.nan
