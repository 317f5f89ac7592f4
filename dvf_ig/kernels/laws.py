"""Force laws as scalars of a signed distance (Ren 2008, eqs 4–9), for use inside other kernels.

Both return f in [−1, 1] such that F = −cap·f·n with n the unit gradient of distance, which points into the
organ: the sigmoid pushes out of the organ everywhere, the Gaussian pulls back to its surface from both sides.
"""

import math

from .compiled import inlined

SIGMOID = 0
GAUSSIAN = 1

LARGEST_FORCE_N = 20.0
"""Largest force for any parameters, which the strongest table-top devices (Force Dimension delta) reach."""

DIRECTION_LOST = 0.2
"""|∇d| below which the direction is lost (medial axis, opposing walls) and there is no force."""
DIRECTION_SURE = 0.4
"""|∇d| above which the law is unchanged; between the two it fades by smoothstep (docs/theory/fixtures.md)."""


@inlined
def signed_potential(kind: int, scale: float, exponent: float, s_mm: float) -> float:
    """Compute the law's f(s).

    Args:
        kind: SIGMOID or GAUSSIAN.
        scale: γ (1/mm) of the sigmoid, δ (mm) of the Gaussian.
        exponent: m of the Gaussian; unused by the sigmoid.
        s_mm: distance below the guarded depth.
    """
    if kind == SIGMOID:
        return 1.0 / (1.0 + math.exp(-scale * s_mm))
    ratio = (s_mm / scale) * (s_mm / scale)
    if exponent != 1.0:
        ratio = ratio**exponent
    return math.copysign(-math.expm1(-ratio), s_mm)


@inlined
def direction_certainty(gradient_norm: float) -> float:
    """smoothstep(|∇d|, 0.2, 0.4)."""
    t = (gradient_norm - DIRECTION_LOST) / (DIRECTION_SURE - DIRECTION_LOST)
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)
