"""Position of a phase in the cycle, and the weights of the phases around it (α of Ren 2008, eq. 10)."""

import numpy as np

from dvf_ig.core import FloatArray

from .compiled import inlined
from .lanes import Float64x4, fma, pack, scale, unpack

Weights4 = tuple[float, float, float, float]


@inlined
def phase_bracket(times: FloatArray, start: int, count: int, phi: float) -> tuple[int, int, float, float]:
    """Find neighbouring phases of `phi` (cyclic), the weight of the second, and their distance in cycles.

    The search starts at the index for evenly spaced phases, and ends at once for these.

    Args:
        times: holds the phase times as fractions of the cycle, `count` of them from `start` on.
        phi: model phase.
    """
    phi -= np.floor(phi)  # a float: math.floor makes an integer here, and 1e19 has none
    before = min(int(phi * count), count - 1)
    while before < count - 1 and times[start + before + 1] <= phi:
        before += 1
    while before >= 0 and times[start + before] > phi:
        before -= 1
    first = before if before >= 0 else count - 1
    second = before + 1 if before + 1 < count else 0
    width = times[start + second] - times[start + first]
    past = phi - times[start + first]
    width = width + 1.0 if width <= 0.0 else width
    past = past + 1.0 if past < 0.0 else past
    return first, second, past / width, width


@inlined
def _row(c: FloatArray, k: int) -> Float64x4:
    return pack(c[k], c[k + 1], c[k + 2], c[k + 3])


@inlined
def cubic_in_phase(powers: FloatArray, start: int, alpha: float) -> tuple[Weights4, Weights4]:
    """Compute weights of the four phases around an interval, and their derivatives by alpha.

    Args:
        powers: from `start` on, the coefficients of 1, α, α², α³ for phases first−1 … first+2, 16 numbers.
        alpha: position in the interval, 0 … 1.
    """
    one, a1 = _row(powers, start), _row(powers, start + 4)
    a2, a3 = _row(powers, start + 8), _row(powers, start + 12)
    weights = fma(one, alpha, fma(a1, alpha, fma(a2, alpha, a3)))
    slopes = fma(a1, alpha, fma(scale(2.0, a2), alpha, scale(3.0, a3)))
    return unpack(weights), unpack(slopes)
