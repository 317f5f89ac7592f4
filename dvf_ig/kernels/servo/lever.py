"""Lever of an instrument that passes through a fixed point of the body wall.

With P the point, r = |hand − P|, u = (hand − P)/r and L the length from the hand to the tip,

    tip = P − (L − r) u,    λ = (L − r)/r,    ẋ_tip = J ẋ_hand,    J = u uᵀ − λ (I − u uᵀ)

motion along the instrument is kept, motion across it is inverted and scaled by λ. By virtual work,
F_hand·ẋ_hand = F_tip·ẋ_tip, so F_hand = Jᵀ F_tip, and J is symmetric.

What is K at the tip is λ² K in the hand, so a force on a tip that moves further than the hand is softened to
1/λ² of it: in the hand no wall is steeper, and no damping larger, than the device was found to render.
"""

import math
from typing import Any

from dvf_ig.core import FloatArray
from dvf_ig.kernels.compiled import inlined, kernel

LEAST_LEVER, MOST_LEVER = 0.05, 5.0
"""Levers with which a force is given: below, the tip is about to leave the body; above, the hand to enter."""


@kernel
def tip_of_hand(m: Any, tool: Any, place: FloatArray) -> None:
    """Turn the hand's place (3,) into the tip's, in place; lever and direction into the memory."""
    x, y, z = place[0] - tool.trocar_mm[0], place[1] - tool.trocar_mm[1], place[2] - tool.trocar_mm[2]
    r = math.sqrt(x * x + y * y + z * z)
    m.to_hand[0], m.to_hand[1], m.to_hand[2] = x / r, y / r, z / r
    m.lever = (tool.length_mm - r) / r
    for k in range(3):
        place[k] = tool.trocar_mm[k] - (tool.length_mm - r) * m.to_hand[k]


@inlined
def lever_in_range(m: Any) -> bool:
    """Return whether hand and tip are on either side of the body wall; False for NaN."""
    return bool(LEAST_LEVER <= m.lever <= MOST_LEVER)


@inlined
def softening(m: Any) -> float:
    """Share of a force, stiffness or damping at the tip that is rendered."""
    lever = min(m.lever, MOST_LEVER)
    return 1.0 / (lever * lever) if lever > 1.0 else 1.0


@inlined
def across(m: Any, v: FloatArray, scale: float, out: FloatArray) -> None:
    """Write (u uᵀ − scale (I − u uᵀ)) v to `out` (3,)."""
    u = m.to_hand
    along = (1.0 + scale) * (u[0] * v[0] + u[1] * v[1] + u[2] * v[2])
    for k in range(3):
        out[k] = along * u[k] - scale * v[k]


@kernel
def force_on_hand(m: Any, force_n: FloatArray) -> None:
    """Turn a force on the tip (3,) into the one on the hand that does the same work, in place."""
    across(m, force_n, min(max(m.lever, LEAST_LEVER), MOST_LEVER), force_n)


@kernel
def force_on_tip(m: Any, force_n: FloatArray, out: FloatArray) -> None:
    """Write the force on the tip (3,) that does the work of one on the hand."""
    across(m, force_n, 1.0 / min(max(m.lever, LEAST_LEVER), MOST_LEVER), out)
