"""Trilinear lookups in the reference heart, and images made by pulling voxels back into it."""

import numpy as np
from numba import njit

from dvf_ig.core import AnyArray

Point = tuple[float, float, float]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def cell(u: float, count: int) -> tuple[int, float]:
    """Lower node and weight of a continuous index, clamped to the grid."""
    u = min(max(u, 0.0), count - 1.0)
    i = int(u)
    if i > count - 2:
        i = count - 2
    return i, u - i


@njit(cache=True, nogil=True, error_model="numpy")
def reference_point(
    x: float,
    y: float,
    z: float,
    displacement: AnyArray,
    origin: AnyArray,
    inverse_spacing: float,
    first: int,
    second: int,
    weight: float,
) -> Point:
    """X = χ⁻¹(x) by linear interpolation in space and between two knots."""
    nx, ny, nz = displacement.shape[1], displacement.shape[2], displacement.shape[3]
    i, fx = cell((x - origin[0]) * inverse_spacing, nx)
    j, fy = cell((y - origin[1]) * inverse_spacing, ny)
    k, fz = cell((z - origin[2]) * inverse_spacing, nz)
    dx, dy, dz = 0.0, 0.0, 0.0
    for knot in range(2):
        n = first if knot == 0 else second
        share = 1.0 - weight if knot == 0 else weight
        if share == 0.0:
            continue
        for a in range(2):
            wa = share * (fx if a else 1.0 - fx)
            for b in range(2):
                wb = wa * (fy if b else 1.0 - fy)
                low = wb * (1.0 - fz)
                high = wb * fz
                near = displacement[n, i + a, j + b, k]
                far = displacement[n, i + a, j + b, k + 1]
                dx += low * near[0] + high * far[0]
                dy += low * near[1] + high * far[1]
                dz += low * near[2] + high * far[2]
    return x + dx, y + dy, z + dz


@njit(cache=True, nogil=True, error_model="numpy")
def pull_back(
    points: AnyArray,
    displacement: AnyArray,
    origin: AnyArray,
    inverse_spacing: float,
    first: AnyArray,
    second: AnyArray,
    weight: AnyArray,
    out: AnyArray,
) -> None:
    """Reference positions of (n, 3) points, each at its own pair of knots (n,)."""
    for i in range(len(points)):
        out[i, 0], out[i, 1], out[i, 2] = reference_point(
            points[i, 0],
            points[i, 1],
            points[i, 2],
            displacement,
            origin,
            inverse_spacing,
            first[i],
            second[i],
            weight[i],
        )


@njit(cache=True, nogil=True, error_model="numpy")
def polish(
    points: AnyArray,
    forward: AnyArray,
    origin: AnyArray,
    inverse_spacing: float,
    first: AnyArray,
    second: AnyArray,
    weight: AnyArray,
    out: AnyArray,
) -> None:
    """Improve `out`, guesses of X with X + u(X) = x, to 1e-4 mm; u trilinear, each point at its own knots."""
    for i in range(len(points)):
        gx, gy, gz = out[i, 0], out[i, 1], out[i, 2]
        best, damping = 1e18, 1.0
        bx, by, bz, ex, ey, ez = gx, gy, gz, 0.0, 0.0, 0.0
        for _ in range(80):
            fx, fy, fz = reference_point(
                gx, gy, gz, forward, origin, inverse_spacing, first[i], second[i], weight[i]
            )
            rx, ry, rz = points[i, 0] - fx, points[i, 1] - fy, points[i, 2] - fz
            error = rx * rx + ry * ry + rz * rz
            if error < best:
                best, bx, by, bz, ex, ey, ez = error, gx, gy, gz, rx, ry, rz
                if error < 1e-8:
                    break
            else:
                damping *= 0.6
            gx, gy, gz = bx + damping * ex, by + damping * ey, bz + damping * ez
        out[i, 0], out[i, 1], out[i, 2] = bx, by, bz


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _taps(f: float) -> tuple[float, float, float, float]:
    """Catmull-Rom weights of the four nodes around a fraction."""
    return (
        f * (-0.5 + f * (1.0 - 0.5 * f)),
        1.0 + f * f * (-2.5 + 1.5 * f),
        f * (0.5 + f * (2.0 - 1.5 * f)),
        f * f * (-0.5 + 0.5 * f),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def cubic_point(
    x: float, y: float, z: float, field: AnyArray, origin: AnyArray, inverse_spacing: float
) -> Point:
    """Tricubic (Catmull-Rom) value of a (nx, ny, nz, 3) field, clamped one node inside its border."""
    u = min(max((x - origin[0]) * inverse_spacing, 1.0), field.shape[0] - 2.000001)
    v = min(max((y - origin[1]) * inverse_spacing, 1.0), field.shape[1] - 2.000001)
    w = min(max((z - origin[2]) * inverse_spacing, 1.0), field.shape[2] - 2.000001)
    i, j, k = int(u), int(v), int(w)
    wi, wj, wk = _taps(u - i), _taps(v - j), _taps(w - k)
    dx, dy, dz = 0.0, 0.0, 0.0
    for a in range(4):
        for b in range(4):
            share = wi[a] * wj[b]
            for c in range(4):
                weight = share * wk[c]
                node = field[i + a - 1, j + b - 1, k + c - 1]
                dx += weight * node[0]
                dy += weight * node[1]
                dz += weight * node[2]
    return dx, dy, dz


@njit(cache=True, nogil=True, error_model="numpy")
def cubic_at(
    points: AnyArray, field: AnyArray, origin: AnyArray, inverse_spacing: float, out: AnyArray
) -> None:
    """`cubic_point` of (n, 3) points."""
    for i in range(len(points)):
        out[i, 0], out[i, 1], out[i, 2] = cubic_point(
            points[i, 0], points[i, 1], points[i, 2], field, origin, inverse_spacing
        )


@njit(cache=True, nogil=True, error_model="numpy")
def scalar_at(
    x: float, y: float, z: float, values: AnyArray, origin: AnyArray, inverse_spacing: float
) -> float:
    """Trilinear value of a scalar grid, clamped at its border."""
    i, fx = cell((x - origin[0]) * inverse_spacing, values.shape[0])
    j, fy = cell((y - origin[1]) * inverse_spacing, values.shape[1])
    k, fz = cell((z - origin[2]) * inverse_spacing, values.shape[2])
    total = 0.0
    for a in range(2):
        wa = fx if a else 1.0 - fx
        for b in range(2):
            wb = wa * (fy if b else 1.0 - fy)
            total += wb * ((1.0 - fz) * values[i + a, j + b, k] + fz * values[i + a, j + b, k + 1])
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def nearest(u: float, count: int) -> int:
    return min(max(int(u + 0.5), 0), count - 1)


@njit(cache=True, nogil=True, error_model="numpy")
def sampled(
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
    """MR signal and tissue code (n,) at (n, 3) reference positions."""
    for i in range(len(positions)):
        u, v, w = positions[i, 0], positions[i, 1], positions[i, 2]
        signal_out[i] = scalar_at(u, v, w, signal, map_origin, map_inverse_spacing)
        depth = scalar_at(u, v, w, organ, map_origin, map_inverse_spacing)
        a = nearest((u - map_origin[0]) * map_inverse_spacing, inner.shape[0])
        b = nearest((v - map_origin[1]) * map_inverse_spacing, inner.shape[1])
        c = nearest((w - map_origin[2]) * map_inverse_spacing, inner.shape[2])
        code_out[i] = inner[a, b, c] if depth > 0.0 else outer[a, b, c]


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def fill_middles(path: AnyArray, stride: int) -> None:
    """Put the point half-way between every `stride`-th point of (lines, count, 3) paths into their middle."""
    half = stride // 2
    for line in range(path.shape[0]):
        for i in range(0, path.shape[1] - stride, stride):
            for k in range(3):
                path[line, i + half, k] = 0.5 * (path[line, i, k] + path[line, i + stride, k])
