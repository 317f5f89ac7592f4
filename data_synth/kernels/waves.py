"""A sum of plane waves at many points."""

import math

import numpy as np

from dvf_ig.core import AnyArray

from .compiled import kernel

BLOCK = 64
"""Points processed together: enough for the compiler to put several into one vector register."""
TURN_HIGH, TURN_LOW = 6.2831854820251465, -1.748455600074497e-07
"""2π in two parts, the first of 24 bits, so that whole multiples of it are exact."""
_SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(8))
_COSINE = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(9))
S1, S3, S5, S7, S9, S11, S13, S15 = _SINE
C0, C2, C4, C6, C8, C10, C12, C14, C16 = _COSINE


@kernel(nogil=True, error_model="numpy", inline="always")
def cosine_and_sine(angle: float) -> tuple[float, float]:
    """Compute both to 1e-14 for angles up to a million, without branch or call: a loop is vectorised.

    By series of a quarter of the angle within ±π, doubled twice.
    """
    turns = np.floor(angle / (TURN_HIGH + TURN_LOW) + 0.5)
    x = 0.25 * ((angle - turns * TURN_HIGH) - turns * TURN_LOW)
    q = x * x
    s = x * (S1 + q * (S3 + q * (S5 + q * (S7 + q * (S9 + q * (S11 + q * (S13 + q * S15)))))))
    c = C0 + q * (C2 + q * (C4 + q * (C6 + q * (C8 + q * (C10 + q * (C12 + q * (C14 + q * C16)))))))
    s, c = 2.0 * s * c, 1.0 - 2.0 * s * s
    return 1.0 - 2.0 * s * s, 2.0 * s * c


@kernel(nogil=True, error_model="numpy")
def wave_sum(relative: AnyArray, waves: AnyArray, cosine: AnyArray, sine: AnyArray, out: AnyArray) -> None:
    """Compute Σ A cos(k·r) + B sin(k·r) of (n, 3) points into `out`, in a fixed order of summation."""
    places, sums = np.empty((3, BLOCK)), np.empty((3, BLOCK))
    for begin in range(0, len(relative), BLOCK):
        count = min(BLOCK, len(relative) - begin)
        for i in range(count):  # for an array into an array numba compiles its error message, 2 s
            for axis in range(3):
                places[axis, i] = relative[begin + i, axis]
        sums[:] = 0.0
        for m in range(len(waves)):
            kx, ky, kz = waves[m, 0], waves[m, 1], waves[m, 2]
            for i in range(BLOCK):
                c, s = cosine_and_sine(kx * places[0, i] + ky * places[1, i] + kz * places[2, i])
                sums[0, i] += cosine[m, 0] * c + sine[m, 0] * s
                sums[1, i] += cosine[m, 1] * c + sine[m, 1] * s
                sums[2, i] += cosine[m, 2] * c + sine[m, 2] * s
        for i in range(count):
            for axis in range(3):
                out[begin + i, axis] = sums[axis, i]
