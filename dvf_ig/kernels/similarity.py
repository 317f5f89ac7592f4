"""LC2: local linear combination of two channels, evaluated on tracked slices (Fuerst 2014; Wein 2013).

In each square patch of a slice the ultrasound u is fitted by α·a + β·b + γ, where a and b are two channels of
the model at that place (MR intensity and gradient magnitude, or blood and wall maps). The patch scores
S = 1 − Var(residual)/Var(u), the slice the mean of S weighted by the patch's standard deviation of u.

Window sums come from integral images, so the cost does not depend on the patch size. Each slice writes its
own results: they are the same at any thread count.
"""

import math

import numpy as np
from numba import njit, prange

RIDGE = 1e-4
"""Added to both channel variances; the channels are scaled to unit variance over the heart."""


@njit(cache=True, nogil=True, inline="always", error_model="numpy")  # type: ignore[untyped-decorator]
def _window(table, row, col, radius):  # type: ignore[no-untyped-def]
    """Sum over the (2·radius + 1)² window about (row, col) from an integral image padded by radius + 1."""
    r0, r1 = row, row + 2 * radius + 1
    c0, c1 = col, col + 2 * radius + 1
    return table[r1, c1] - table[r0, c1] - table[r1, c0] + table[r0, c0]


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def integrate(image, radius, table):  # type: ignore[no-untyped-def]
    """Integral image of `image` (rows, columns), padded by `radius` of zeros on each side, into `table`."""
    rows, cols = image.shape
    height, width = table.shape
    for c in range(width):
        table[0, c] = 0.0
    for r in range(1, height):
        total = 0.0
        table[r, 0] = 0.0
        ir = r - 1 - radius
        for c in range(1, width):
            ic = c - 1 - radius
            if 0 <= ir < rows and 0 <= ic < cols:
                total += image[ir, ic]
            table[r, c] = table[r - 1, c] + total


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def sample_channels(channels, phase, matrix, mask, out):  # type: ignore[no-untyped-def]
    """Trilinear values of both channels at every masked pixel of one slice.

    Args:
        channels: (n, nx, ny, nz, 2) float32.
        phase: which of the n volumes.
        matrix: (3, 3) voxel index from (column, row, 1).
        mask: (rows, columns) bool.
        out: (2, rows, columns) filled with values, 0 outside the mask; the border value outside the volume.
    Returns:
        share of masked pixels that lie inside the volume.
    """
    nx, ny, nz = channels.shape[1], channels.shape[2], channels.shape[3]
    inside, total = 0, 0
    for r in range(mask.shape[0]):
        for c in range(mask.shape[1]):
            if not mask[r, c]:
                out[0, r, c] = 0.0
                out[1, r, c] = 0.0
                continue
            total += 1
            x = matrix[0, 0] * c + matrix[0, 1] * r + matrix[0, 2]
            y = matrix[1, 0] * c + matrix[1, 1] * r + matrix[1, 2]
            z = matrix[2, 0] * c + matrix[2, 1] * r + matrix[2, 2]
            if 0.0 <= x <= nx - 1 and 0.0 <= y <= ny - 1 and 0.0 <= z <= nz - 1:
                inside += 1
            x = min(max(x, 0.0), nx - 1.0)
            y = min(max(y, 0.0), ny - 1.0)
            z = min(max(z, 0.0), nz - 1.0)
            i, j, k = min(int(x), nx - 2), min(int(y), ny - 2), min(int(z), nz - 2)
            fx, fy, fz = x - i, y - j, z - k
            for ch in range(2):
                v = channels[phase, i : i + 2, j : j + 2, k : k + 2, ch]
                v00 = v[0, 0, 0] + fz * (v[0, 0, 1] - v[0, 0, 0])
                v01 = v[0, 1, 0] + fz * (v[0, 1, 1] - v[0, 1, 0])
                v10 = v[1, 0, 0] + fz * (v[1, 0, 1] - v[1, 0, 0])
                v11 = v[1, 1, 0] + fz * (v[1, 1, 1] - v[1, 1, 0])
                v0 = v00 + fy * (v01 - v00)
                v1 = v10 + fy * (v11 - v10)
                out[ch, r, c] = v0 + fx * (v1 - v0)
    return inside / max(total, 1)


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def fit_patch(n, su, suu, sa, sb, saa, sbb, sab, sua, sub):  # type: ignore[no-untyped-def]
    """Best linear fit of u by a and b over one patch, from its sums.

    Returns:
        (explained share S in [0, 1], variance of u, α, β).
    """
    inv = 1.0 / n
    var_u = suu * inv - (su * inv) ** 2
    aa = saa * inv - (sa * inv) ** 2 + RIDGE
    bb = sbb * inv - (sb * inv) ** 2 + RIDGE
    ab = sab * inv - sa * sb * inv * inv
    ua = sua * inv - su * sa * inv * inv
    ub = sub * inv - su * sb * inv * inv
    det = aa * bb - ab * ab
    alpha = (ua * bb - ub * ab) / det
    beta = (ub * aa - ua * ab) / det
    if var_u <= 1e-12:
        return 0.0, 0.0, alpha, beta
    explained = (alpha * ua + beta * ub) / var_u
    return min(max(explained, 0.0), 1.0), var_u, alpha, beta


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")  # type: ignore[untyped-decorator]
def lc2_slices(  # type: ignore[no-untyped-def]
    images,
    masks,
    count_sum,
    u_sum,
    uu_sum,
    matrices,
    phases,
    channels,
    radius,
    min_count,
    values,
    tables,
    out,
):
    """Score every slice; see the module docstring.

    Args:
        images: (s, rows, columns) float32 ultrasound, 0 outside the mask.
        masks: (s, rows, columns) bool.
        count_sum, u_sum, uu_sum: (s, height, width) integral images of mask, u and u².
        matrices: (s, 3, 3) voxel index from (column, row, 1).
        phases: (s,) which volume each slice is compared with.
        channels: (n, nx, ny, nz, 2) float32.
        radius, min_count: patch radius in pixels, and the fewest pixels a patch may have.
        values: (s, 2, rows, columns) float64 scratch; tables: (s, 7, height, width) float64 scratch.
        out: (s, 3) filled with Σ w·S, Σ w, and the share of pixels inside the volume.
    """
    rows, cols = images.shape[1], images.shape[2]
    for s in prange(images.shape[0]):
        value, table, mask, image = values[s], tables[s], masks[s], images[s]
        out[s, 2] = sample_channels(channels, phases[s], matrices[s], mask, value)
        height, width = table.shape[1], table.shape[2]
        for q in range(7):
            for c in range(width):
                table[q, 0, c] = 0.0
        for r in range(1, height):
            ta = tb = taa = tbb = tab = tua = tub = 0.0
            for q in range(7):
                table[q, r, 0] = 0.0
            ir = r - 1 - radius
            for c in range(1, width):
                ic = c - 1 - radius
                if 0 <= ir < rows and 0 <= ic < cols:
                    a, b, u = value[0, ir, ic], value[1, ir, ic], image[ir, ic]
                    ta += a
                    tb += b
                    taa += a * a
                    tbb += b * b
                    tab += a * b
                    tua += u * a
                    tub += u * b
                table[0, r, c] = table[0, r - 1, c] + ta
                table[1, r, c] = table[1, r - 1, c] + tb
                table[2, r, c] = table[2, r - 1, c] + taa
                table[3, r, c] = table[3, r - 1, c] + tbb
                table[4, r, c] = table[4, r - 1, c] + tab
                table[5, r, c] = table[5, r - 1, c] + tua
                table[6, r, c] = table[6, r - 1, c] + tub
        score = weight = 0.0
        for r in range(rows):
            for c in range(cols):
                if not mask[r, c]:
                    continue
                n = _window(count_sum[s], r, c, radius)
                if n < min_count:
                    continue
                share, var_u, _, _ = fit_patch(
                    n,
                    _window(u_sum[s], r, c, radius),
                    _window(uu_sum[s], r, c, radius),
                    _window(table[0], r, c, radius),
                    _window(table[1], r, c, radius),
                    _window(table[2], r, c, radius),
                    _window(table[3], r, c, radius),
                    _window(table[4], r, c, radius),
                    _window(table[5], r, c, radius),
                    _window(table[6], r, c, radius),
                )
                w = math.sqrt(max(var_u, 0.0))
                score += w * share
                weight += w
        out[s, 0] = score
        out[s, 1] = weight


def lc2_reference(image, mask, first, second, radius, min_count):  # type: ignore[no-untyped-def]
    """Readable twin of one slice's score: loops over patches and solves each fit by least squares."""
    score = weight = 0.0
    rows, cols = image.shape
    for r in range(rows):
        for c in range(cols):
            window = np.zeros_like(mask)
            window[max(0, r - radius) : r + radius + 1, max(0, c - radius) : c + radius + 1] = True
            window &= mask
            n = int(window.sum())
            if not mask[r, c] or n < min_count:
                continue
            u, a, b = (x[window] - x[window].mean() for x in (image, first, second))
            normal = np.array([[a @ a, a @ b], [a @ b, b @ b]]) / n + RIDGE * np.eye(2)
            right = np.array([u @ a, u @ b]) / n
            var_u = float(u @ u) / n
            if var_u <= 1e-12:
                continue
            share = float(np.clip(right @ np.linalg.solve(normal, right) / var_u, 0, 1))
            score += math.sqrt(var_u) * share
            weight += math.sqrt(var_u)
    return score, weight
