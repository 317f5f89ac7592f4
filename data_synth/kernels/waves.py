"""A sum of plane waves at many points."""

import numpy as np
from numba import njit

from dvf_ig.core import AnyArray


@njit(cache=True, nogil=True, error_model="numpy")
def wave_sum(relative: AnyArray, waves: AnyArray, cosine: AnyArray, sine: AnyArray, out: AnyArray) -> None:
    """Σ A cos(k·r) + B sin(k·r) of (n, 3) points into `out`, in a fixed order of summation."""
    for i in range(len(relative)):
        x, y, z = relative[i, 0], relative[i, 1], relative[i, 2]
        u, v, w = 0.0, 0.0, 0.0
        for m in range(len(waves)):
            angle = waves[m, 0] * x + waves[m, 1] * y + waves[m, 2] * z
            c, s = np.cos(angle), np.sin(angle)
            u += cosine[m, 0] * c + sine[m, 0] * s
            v += cosine[m, 1] * c + sine[m, 1] * s
            w += cosine[m, 2] * c + sine[m, 2] * s
        out[i, 0], out[i, 1], out[i, 2] = u, v, w
