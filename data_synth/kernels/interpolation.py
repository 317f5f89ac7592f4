"""Sampling of a grid between its nodes: nearest, trilinear and tricubic, clamped at the border."""

from dvf_ig.core import AnyArray

from .compiled import kernel

Point = tuple[float, float, float]


@kernel(nogil=True, error_model="numpy", inline="always")
def cell(u: float, count: int) -> tuple[int, float]:
    """Find the lower node and weight of a continuous index, clamped to the grid."""
    u = min(max(u, 0.0), count - 1.0)
    i = int(u)
    if i > count - 2:
        i = count - 2
    return i, u - i


@kernel(nogil=True, error_model="numpy")
def nearest(u: float, count: int) -> int:
    """Find the index of the node nearest to `u`, in [0, count)."""
    return min(max(int(u + 0.5), 0), count - 1)


@kernel(nogil=True, error_model="numpy")
def scalar_at(
    x: float, y: float, z: float, values: AnyArray, origin: AnyArray, inverse_spacing: float
) -> float:
    """Interpolate a scalar grid trilinearly, clamped at its border."""
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


@kernel(nogil=True, error_model="numpy")
def channels_at(
    x: float, y: float, z: float, values: AnyArray, origin: AnyArray, inverse_spacing: float
) -> tuple[float, float, float, float, float]:
    """Interpolate a grid of five channels, (nx, ny, nz, 5), trilinearly, clamped at its border."""
    i, fx = cell((x - origin[0]) * inverse_spacing, values.shape[0])
    j, fy = cell((y - origin[1]) * inverse_spacing, values.shape[1])
    k, fz = cell((z - origin[2]) * inverse_spacing, values.shape[2])
    first, second, third, fourth, fifth = 0.0, 0.0, 0.0, 0.0, 0.0
    for a in range(2):
        wa = fx if a else 1.0 - fx
        for b in range(2):
            wb = wa * (fy if b else 1.0 - fy)
            for c in range(2):
                share = wb * (fz if c else 1.0 - fz)
                node = values[i + a, j + b, k + c]
                first += share * node[0]
                second += share * node[1]
                third += share * node[2]
                fourth += share * node[3]
                fifth += share * node[4]
    return first, second, third, fourth, fifth


@kernel(nogil=True, error_model="numpy", inline="always")
def _catmull_rom(f: float) -> tuple[float, float, float, float]:
    """Compute Catmull-Rom weights of the four nodes around a fraction."""
    return (
        f * (-0.5 + f * (1.0 - 0.5 * f)),
        1.0 + f * f * (-2.5 + 1.5 * f),
        f * (0.5 + f * (2.0 - 1.5 * f)),
        f * f * (-0.5 + 0.5 * f),
    )


@kernel(nogil=True, error_model="numpy")
def cubic_point(
    x: float, y: float, z: float, field: AnyArray, origin: AnyArray, inverse_spacing: float
) -> Point:
    """Interpolate a (nx, ny, nz, 3) field by tricubic Catmull-Rom, clamped one node inside its border."""
    u = min(max((x - origin[0]) * inverse_spacing, 1.0), field.shape[0] - 2.000001)
    v = min(max((y - origin[1]) * inverse_spacing, 1.0), field.shape[1] - 2.000001)
    w = min(max((z - origin[2]) * inverse_spacing, 1.0), field.shape[2] - 2.000001)
    i, j, k = int(u), int(v), int(w)
    wi, wj, wk = _catmull_rom(u - i), _catmull_rom(v - j), _catmull_rom(w - k)
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


@kernel(nogil=True, error_model="numpy")
def cubic_at(
    points: AnyArray, field: AnyArray, origin: AnyArray, inverse_spacing: float, out: AnyArray
) -> None:
    """Compute `cubic_point` of (n, 3) points."""
    for i in range(len(points)):
        out[i, 0], out[i, 1], out[i, 2] = cubic_point(
            points[i, 0], points[i, 1], points[i, 2], field, origin, inverse_spacing
        )
