"""Gauss–Newton normal equations of LC2: which small motion of the model explains the slices better.

With the local fit of every patch held (α, β, γ of `similarity`), 1 − S is a weighted sum of squared residuals
u − α·a − β·b − γ, and a and b change with the pose by their gradients. Every pixel lies in many patches; what
it needs of them are seven sums, which come from integral images of differences as the window sums do.
"""

import numpy as np
from numpy.typing import NDArray

from .compiled import inlined, kernel
from .lc2 import Bools, Floats, Ints, integrate_products, patch_moments

HELD = 7
"""Sums over the patches of a pixel: cα², cαβ, cβ², cα, cβ, cαγ, cβγ with c = w/(n·Var u)."""
NORMAL = 27
"""21 of the lower triangle of JᵀJ by rows, then 6 of Jᵀr."""

Vector6 = tuple[float, float, float, float, float, float]


@kernel
def sample_gradients(
    channels: NDArray[np.float32], phase: int, matrix: Floats, mask: Bools, values: Floats, slopes: Floats
) -> None:
    """Trilinear values and gradients of both channels at every masked pixel.

    Args:
        channels: (n, nx, ny, nz, 2); phase: which of the n volumes.
        matrix: (3, 3) voxel index from (column, row, 1).
        mask: (rows, columns).
        values: (rows, columns, 2) out, as `sample_channels`.
        slopes: (rows, columns, 6) out: ∇a then ∇b per voxel; 0 outside the mask.
    """
    volume = channels[phase]
    top_x, top_y, top_z = volume.shape[0] - 1.0, volume.shape[1] - 1.0, volume.shape[2] - 1.0
    for r in range(mask.shape[0]):
        for c in range(mask.shape[1]):
            for q in range(6):
                slopes[r, c, q] = 0.0
            values[r, c, 0] = 0.0
            values[r, c, 1] = 0.0
            if not mask[r, c]:
                continue
            x = matrix[0, 0] * c + matrix[0, 1] * r + matrix[0, 2]
            y = matrix[1, 0] * c + matrix[1, 1] * r + matrix[1, 2]
            z = matrix[2, 0] * c + matrix[2, 1] * r + matrix[2, 2]
            # beyond the volume its border value goes on, so nothing changes along that axis
            move_x, move_y, move_z = 0.0 <= x <= top_x, 0.0 <= y <= top_y, 0.0 <= z <= top_z
            x = min(max(x, 0.0), top_x)
            y = min(max(y, 0.0), top_y)
            z = min(max(z, 0.0), top_z)
            i, j, k = min(int(x), int(top_x) - 1), min(int(y), int(top_y) - 1), min(int(z), int(top_z) - 1)
            fx, fy, fz = x - i, y - j, z - k
            for ch in range(2):
                # rows along z: value and slope at the four edges of the cell
                v00, s00 = volume[i, j, k, ch], volume[i, j, k + 1, ch] - volume[i, j, k, ch]
                v01, s01 = volume[i, j + 1, k, ch], volume[i, j + 1, k + 1, ch] - volume[i, j + 1, k, ch]
                v10, s10 = volume[i + 1, j, k, ch], volume[i + 1, j, k + 1, ch] - volume[i + 1, j, k, ch]
                v11 = volume[i + 1, j + 1, k, ch]
                s11 = volume[i + 1, j + 1, k + 1, ch] - v11
                e00, e01, e10, e11 = v00 + fz * s00, v01 + fz * s01, v10 + fz * s10, v11 + fz * s11
                near, far = e00 + fy * (e01 - e00), e10 + fy * (e11 - e10)
                values[r, c, ch] = near + fx * (far - near)
                if move_x:
                    slopes[r, c, 3 * ch] = far - near
                if move_y:
                    slopes[r, c, 3 * ch + 1] = (1 - fx) * (e01 - e00) + fx * (e11 - e10)
                if move_z:
                    slopes[r, c, 3 * ch + 2] = (1 - fx) * ((1 - fy) * s00 + fy * s01) + fx * (
                        (1 - fy) * s10 + fy * s11
                    )


@inlined
def _add(
    held: Floats, r: int, c: int, sign: float, sums: tuple[float, float, float, float, float, float, float]
) -> None:
    for q in range(HELD):
        held[r, c, q] += sign * sums[q]


@kernel
def hold_fits(
    table: Floats, boxes: Ints, moments: Floats, begin: int, end: int, held: Floats
) -> tuple[float, float]:
    """Fit patches begin <= p < end and spread what pixels need of them.

    Args:
        table: integral images of `integrate_products`.
        boxes, moments: (p, 4), (p, 4) as in `lc2_slices`.
        held: (rows + 1, columns + 1, HELD) out: at pixel (r, c) the sums over its patches.
    Returns:
        Σ w·S and Σ w.
    """
    for r in range(held.shape[0]):
        for c in range(held.shape[1]):
            for q in range(HELD):
                held[r, c, q] = 0.0
    score, total = 0.0, 0.0
    for p in range(begin, end):
        box = (boxes[p, 0], boxes[p, 1], boxes[p, 2], boxes[p, 3])
        inverse, mean_u, var_u = moments[p, 0], moments[p, 1], moments[p, 2]
        a, b, aa, bb, ab, ua, ub = patch_moments(table, box, inverse, mean_u)
        determinant = aa * bb - ab * ab
        alpha, beta = (ua * bb - ub * ab) / determinant, (ub * aa - ua * ab) / determinant
        gamma = mean_u - alpha * a - beta * b
        w = moments[p, 3]
        score += w * min(max((alpha * ua + beta * ub) / var_u, 0.0), 1.0)
        total += w
        c = w * inverse / var_u
        sums = (
            c * alpha * alpha,
            c * alpha * beta,
            c * beta * beta,
            c * alpha,
            c * beta,
            c * alpha * gamma,
            c * beta * gamma,
        )
        _add(held, box[0], box[2], 1.0, sums)
        _add(held, box[1], box[2], -1.0, sums)
        _add(held, box[0], box[3], -1.0, sums)
        _add(held, box[1], box[3], 1.0, sums)
    for r in range(held.shape[0]):
        for c in range(held.shape[1]):
            for q in range(HELD):
                if r > 0:
                    held[r, c, q] += held[r - 1, c, q]
                if c > 0:
                    held[r, c, q] += held[r, c - 1, q]
                if r > 0 and c > 0:
                    held[r, c, q] -= held[r - 1, c - 1, q]
    return score, total


@inlined
def _motion(gx: float, gy: float, gz: float, x: float, y: float, z: float, per_radius: float) -> Vector6:
    """Change of a channel with rotation (about the centre, in mm at the radius) and translation."""
    return (
        (y * gz - z * gy) * per_radius,
        (z * gx - x * gz) * per_radius,
        (x * gy - y * gx) * per_radius,
        gx,
        gy,
        gz,
    )


@kernel
def lc2_normal_slices(
    images: NDArray[np.float32],
    masks: Bools,
    first_patch: Ints,
    boxes: Ints,
    moments: Floats,
    matrices: Floats,
    places: Floats,
    index_from_mm: Floats,
    phases: Ints,
    channels: NDArray[np.float32],
    radius_mm: float,
    values: Floats,
    slopes: Floats,
    tables: Floats,
    held: Floats,
    out: Floats,
    begin: int,
    end: int,
) -> None:
    """Normal equations of slices begin <= s < end. Several ranges may run at once.

    Args:
        images … matrices, phases, channels, values, tables: as in `lc2_slices`.
        places: (s, 3, 3) mm from the centre of rotation, fixed frame, from (column, row, 1).
        index_from_mm: (3, 3) voxel steps of a mm step.
        radius_mm: what turns rotation into mm.
        slopes: (s, rows, columns, 6) scratch; held: (s, rows + 1, columns + 1, HELD) scratch.
        out: (s, NORMAL + 2) filled with the normal equations of Σ w(1 − S), then Σ w·S and Σ w.
    """
    m = index_from_mm
    for s in range(begin, end):
        sample_gradients(channels, phases[s], matrices[s], masks[s], values[s], slopes[s])
        integrate_products(images[s], values[s], tables[s])
        score, total = hold_fits(tables[s], boxes, moments, first_patch[s], first_patch[s + 1], held[s])
        for q in range(NORMAL):
            out[s, q] = 0.0
        out[s, NORMAL], out[s, NORMAL + 1] = score, total
        for r in range(images.shape[1]):
            for c in range(images.shape[2]):
                if not masks[s, r, c]:
                    continue
                h = held[s, r, c]
                x = places[s, 0, 0] * c + places[s, 0, 1] * r + places[s, 0, 2]
                y = places[s, 1, 0] * c + places[s, 1, 1] * r + places[s, 1, 2]
                z = places[s, 2, 0] * c + places[s, 2, 1] * r + places[s, 2, 2]
                g = slopes[s, r, c]
                ja = _motion(
                    m[0, 0] * g[0] + m[1, 0] * g[1] + m[2, 0] * g[2],
                    m[0, 1] * g[0] + m[1, 1] * g[1] + m[2, 1] * g[2],
                    m[0, 2] * g[0] + m[1, 2] * g[1] + m[2, 2] * g[2],
                    x, y, z, 1.0 / radius_mm,
                )  # fmt: skip
                jb = _motion(
                    m[0, 0] * g[3] + m[1, 0] * g[4] + m[2, 0] * g[5],
                    m[0, 1] * g[3] + m[1, 1] * g[4] + m[2, 1] * g[5],
                    m[0, 2] * g[3] + m[1, 2] * g[4] + m[2, 2] * g[5],
                    x, y, z, 1.0 / radius_mm,
                )  # fmt: skip
                u, a, b = images[s, r, c], values[s, r, c, 0], values[s, r, c, 1]
                ra = u * h[3] - a * h[0] - b * h[1] - h[5]
                rb = u * h[4] - a * h[1] - b * h[2] - h[6]
                q = 0
                for i in range(6):
                    for j in range(i + 1):
                        out[s, q] += (
                            h[0] * ja[i] * ja[j]
                            + h[1] * (ja[i] * jb[j] + jb[i] * ja[j])
                            + h[2] * jb[i] * jb[j]
                        )
                        q += 1
                for i in range(6):
                    out[s, 21 + i] += ra * ja[i] + rb * jb[i]
