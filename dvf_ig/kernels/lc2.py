"""LC2: local linear combination of two channels, evaluated on tracked slices (Fuerst 2014; Wein 2013).

In each square patch of a slice the ultrasound u is fitted by α·a + β·b + γ, where a and b are two channels of
the model at that place (MR intensity and gradient magnitude, or blood and wall maps). The patch scores
S = 1 − Var(residual)/Var(u), the slice the weighted mean of S.

Window sums come from integral images, so the cost does not depend on the patch size; the seven sums of a
pixel lie side by side, so a window costs four cache lines. What depends on u alone is computed once per slice
set. Each slice writes its own results: they are the same at any thread count.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .compiled import inlined, kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

SUMS = 7
"""a, b, a², b², ab, ua, ub."""
RIDGE = 1e-4
"""Added to both channel variances; the channels are scaled to unit variance over the model's volume."""


@kernel
def sample_channels(
    channels: NDArray[np.float32], phase: int, matrix: Floats, mask: Bools, out: Floats
) -> float:
    """Trilinear values of both channels at every masked pixel of one slice.

    Args:
        channels: (n, nx, ny, nz, 2) float32.
        phase: which of the n volumes.
        matrix: (3, 3) voxel index from (column, row, 1).
        mask: (rows, columns).
        out: (rows, columns, 2) filled with values, 0 outside the mask; the border value outside the volume.
    Returns:
        share of masked pixels that lie inside the volume.
    """
    volume = channels[phase]
    top_x, top_y, top_z = volume.shape[0] - 1.0, volume.shape[1] - 1.0, volume.shape[2] - 1.0
    inside = 0
    total = 0
    for r in range(mask.shape[0]):
        for c in range(mask.shape[1]):
            if not mask[r, c]:
                out[r, c, 0] = 0.0
                out[r, c, 1] = 0.0
                continue
            total += 1
            x = matrix[0, 0] * c + matrix[0, 1] * r + matrix[0, 2]
            y = matrix[1, 0] * c + matrix[1, 1] * r + matrix[1, 2]
            z = matrix[2, 0] * c + matrix[2, 1] * r + matrix[2, 2]
            if 0.0 <= x <= top_x and 0.0 <= y <= top_y and 0.0 <= z <= top_z:
                inside += 1
            x = min(max(x, 0.0), top_x)
            y = min(max(y, 0.0), top_y)
            z = min(max(z, 0.0), top_z)
            i, j, k = min(int(x), int(top_x) - 1), min(int(y), int(top_y) - 1), min(int(z), int(top_z) - 1)
            fx, fy, fz = x - i, y - j, z - k
            w11, w10, w01, w00 = fx * fy, fx * (1 - fy), (1 - fx) * fy, (1 - fx) * (1 - fy)
            for ch in range(2):
                low = (
                    w00 * volume[i, j, k, ch]
                    + w01 * volume[i, j + 1, k, ch]
                    + w10 * volume[i + 1, j, k, ch]
                    + w11 * volume[i + 1, j + 1, k, ch]
                )
                high = (
                    w00 * volume[i, j, k + 1, ch]
                    + w01 * volume[i, j + 1, k + 1, ch]
                    + w10 * volume[i + 1, j, k + 1, ch]
                    + w11 * volume[i + 1, j + 1, k + 1, ch]
                )
                out[r, c, ch] = low + fz * (high - low)
    return inside / max(total, 1)


@kernel
def integrate_products(image: NDArray[np.float32], values: Floats, table: Floats) -> None:
    """Integral images of the seven sums, (rows + 1, columns + 1, 7), first row and column zero.

    Args:
        image: (rows, columns) ultrasound; values: (rows, columns, 2) channels; all 0 outside the mask.
    """
    rows, cols = image.shape
    for c in range(cols + 1):
        for q in range(SUMS):
            table[0, c, q] = 0.0
    for r in range(1, rows + 1):
        sa = sb = saa = sbb = sab = sua = sub = 0.0
        for q in range(SUMS):
            table[r, 0, q] = 0.0
        for c in range(1, cols + 1):
            u, a, b = image[r - 1, c - 1], values[r - 1, c - 1, 0], values[r - 1, c - 1, 1]
            sa += a
            sb += b
            saa += a * a
            sbb += b * b
            sab += a * b
            sua += u * a
            sub += u * b
            table[r, c, 0] = table[r - 1, c, 0] + sa
            table[r, c, 1] = table[r - 1, c, 1] + sb
            table[r, c, 2] = table[r - 1, c, 2] + saa
            table[r, c, 3] = table[r - 1, c, 3] + sbb
            table[r, c, 4] = table[r - 1, c, 4] + sab
            table[r, c, 5] = table[r - 1, c, 5] + sua
            table[r, c, 6] = table[r - 1, c, 6] + sub


@inlined
def window_mean(table: Floats, box: Any, q: int, inverse_count: float) -> float:
    """Mean of sum `q` over the window (first row, last row + 1, first column, last column + 1)."""
    r0, r1, c0, c1 = box
    total = table[r1, c1, q] - table[r0, c1, q] - table[r1, c0, q] + table[r0, c0, q]
    return float(total * inverse_count)


@inlined
def patch_moments(
    table: Floats, box: Any, inverse_count: float, mean_u: float
) -> tuple[float, float, float, float, float, float, float]:
    """Of one patch: means of a and b, ridged variances and covariance, and covariances with u."""
    a = window_mean(table, box, 0, inverse_count)
    b = window_mean(table, box, 1, inverse_count)
    aa = window_mean(table, box, 2, inverse_count) - a * a + RIDGE
    bb = window_mean(table, box, 3, inverse_count) - b * b + RIDGE
    ab = window_mean(table, box, 4, inverse_count) - a * b
    ua = window_mean(table, box, 5, inverse_count) - mean_u * a
    ub = window_mean(table, box, 6, inverse_count) - mean_u * b
    return a, b, aa, bb, ab, ua, ub


@kernel
def explained_share(table: Floats, box: Any, inverse_count: float, mean_u: float, var_u: float) -> float:
    """S of one patch: the share of u's variance that the best α·a + β·b + γ explains."""
    _, _, aa, bb, ab, ua, ub = patch_moments(table, box, inverse_count, mean_u)
    explained = (ua * ua * bb - 2.0 * ua * ub * ab + ub * ub * aa) / (aa * bb - ab * ab)
    return min(max(explained / var_u, 0.0), 1.0)


@kernel
def lc2_slices(
    images: NDArray[np.float32],
    masks: Bools,
    first_patch: Ints,
    boxes: Ints,
    moments: Floats,
    matrices: Floats,
    phases: Ints,
    channels: NDArray[np.float32],
    values: Floats,
    tables: Floats,
    out: Floats,
    begin: int,
    end: int,
) -> None:
    """Score slices begin <= s < end; see the module docstring. Several ranges may run at once.

    Args:
        images: (s, rows, columns) ultrasound, 0 outside the mask; masks: (s, rows, columns).
        first_patch: (s + 1,) where each slice's patches begin.
        boxes: (p, 4) windows; moments: (p, 4) one over the pixel count, mean and variance of u, and weight.
        matrices: (s, 3, 3) voxel index from (column, row, 1).
        phases: (s,) which volume each slice is compared with.
        channels: (n, nx, ny, nz, 2).
        values: (s, rows, columns, 2) scratch; tables: (s, rows + 1, columns + 1, 7) scratch.
        out: (s, 3) filled with Σ w·S, Σ w, and the share of pixels inside the volume.
    """
    for s in range(begin, end):
        out[s, 2] = sample_channels(channels, phases[s], matrices[s], masks[s], values[s])
        integrate_products(images[s], values[s], tables[s])
        score = 0.0
        weight = 0.0
        for p in range(first_patch[s], first_patch[s + 1]):
            box = (boxes[p, 0], boxes[p, 1], boxes[p, 2], boxes[p, 3])
            w = moments[p, 3]
            score += w * explained_share(tables[s], box, moments[p, 0], moments[p, 1], moments[p, 2])
            weight += w
        out[s, 0] = score
        out[s, 1] = weight
