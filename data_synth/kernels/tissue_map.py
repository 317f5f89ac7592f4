"""Kernels on the tissue map: the MR signal at points, and the gradient of the acoustic impedance."""

import numpy as np

from dvf_ig.core import AnyArray

from .compiled import kernel
from .interpolation import nearest, scalar_at


@kernel(nogil=True, error_model="numpy")
def sample_mr(
    positions: AnyArray,
    organ: AnyArray,
    inner: AnyArray,
    outer: AnyArray,
    signal: AnyArray,
    map_origin: AnyArray,
    map_inverse_spacing: float,
    signal_out: AnyArray,
    code_out: AnyArray,
) -> None:
    """Sample MR signal and tissue code (n,) at (n, 3) reference positions."""
    for i in range(len(positions)):
        u, v, w = positions[i, 0], positions[i, 1], positions[i, 2]
        signal_out[i] = scalar_at(u, v, w, signal, map_origin, map_inverse_spacing)
        depth = scalar_at(u, v, w, organ, map_origin, map_inverse_spacing)
        a = nearest((u - map_origin[0]) * map_inverse_spacing, inner.shape[0])
        b = nearest((v - map_origin[1]) * map_inverse_spacing, inner.shape[1])
        c = nearest((w - map_origin[2]) * map_inverse_spacing, inner.shape[2])
        code_out[i] = inner[a, b, c] if depth > 0.0 else outer[a, b, c]


@kernel(nogil=True, error_model="numpy")
def gradient_norm(acoustics: AnyArray, inverse_spacing: float) -> None:
    """Write |∇ channel 0| (central differences, one-sided at the border) into the last channel."""
    nx, ny, nz, last = acoustics.shape[0], acoustics.shape[1], acoustics.shape[2], acoustics.shape[3] - 1
    for i in range(nx):
        a, b = max(i - 1, 0), min(i + 1, nx - 1)
        for j in range(ny):
            c, d = max(j - 1, 0), min(j + 1, ny - 1)
            for k in range(nz):
                e, f = max(k - 1, 0), min(k + 1, nz - 1)
                gx = (acoustics[b, j, k, 0] - acoustics[a, j, k, 0]) / (b - a)
                gy = (acoustics[i, d, k, 0] - acoustics[i, c, k, 0]) / (d - c)
                gz = (acoustics[i, j, f, 0] - acoustics[i, j, e, 0]) / (f - e)
                acoustics[i, j, k, last] = np.sqrt(gx * gx + gy * gy + gz * gz) * inverse_spacing
