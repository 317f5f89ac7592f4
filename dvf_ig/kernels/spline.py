"""Cubic B-spline value and gradient at a point (Ren 2008, eq. 1, degree 3 along each axis).

With u = (q − origin)/knot and i = floor(u), d(q) = Σ c[i+a, j+b, k+e] B_a(x) B_b(y) B_e(z), a, b, e = 0 … 3.
Values and derivatives share their loads: each row of four coefficients along z is read once, sums over y come
first, then over x, then over z.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, IntArray

from . import status as code
from .compiled import inlined, kernel
from .lanes import Float64x4, fma, horizontal_sums, load_row, multiply, pack, scale, unpack

Weights4 = tuple[float, float, float, float]
"""Weights of four neighbouring coefficients."""
Index = Any
"""Index type np.uintp: unsigned indices need no wrap-around test in the compiled code."""
AxisWeights = tuple[Weights4, Weights4]
"""B_0 … B_3 along one axis, and their derivatives."""
Cell = tuple[Index, Index, Index, AxisWeights, AxisWeights, Float64x4, Float64x4]
"""First coefficient along each axis; weights along x and y; weights and derivatives along z, as rows."""


@inlined
def cubic_weights(t: float) -> tuple[Float64x4, Float64x4]:
    """Compute B_0 … B_3 and their derivatives at t in [0, 1], by powers of t."""
    one = pack(1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0, 0.0)
    t1 = pack(-0.5, 0.0, 0.5, 0.0)
    t2 = pack(0.5, -1.0, 0.5, 0.0)
    t3 = pack(-1.0 / 6.0, 0.5, -0.5, 1.0 / 6.0)
    weights = fma(one, t, fma(t1, t, fma(t2, t, t3)))
    slopes = fma(t1, t, fma(scale(2.0, t2), t, scale(3.0, t3)))
    return weights, slopes


@inlined
def inside_box(u: float, v: float, w: float, cells: tuple[int, int, int]) -> bool:
    """Return whether knot coordinates are in the spline's domain; False for NaN."""
    return 0.0 <= u <= cells[0] and 0.0 <= v <= cells[1] and 0.0 <= w <= cells[2]


@inlined
def knot_cell(u: float, cells: int) -> Index:
    """Compute floor(u) for 0 <= u <= cells; the far border belongs to the last cell."""
    return min(np.uintp(u), np.uintp(cells - 1))


@inlined
def find_cell(u: float, v: float, w: float, cells: tuple[int, int, int]) -> Cell:
    """Find the knot cell of coordinates inside the box, and the basis weights there, shared by all phases."""
    i, j, k = knot_cell(u, cells[0]), knot_cell(v, cells[1]), knot_cell(w, cells[2])
    x, dx = cubic_weights(u - i)
    y, dy = cubic_weights(v - j)
    z, dz = cubic_weights(w - k)
    return i, j, k, (unpack(x), unpack(dx)), (unpack(y), unpack(dy)), z, dz


@inlined
def _sum_y(
    c: NDArray[np.float32], p: Index, i: Index, j: Index, k: Index, y: AxisWeights
) -> tuple[Float64x4, Float64x4]:
    """Compute Σ_b B_b(y) of the rows of one slice, also with the derivatives."""
    r0, r1, r2, r3 = (
        load_row(c, p, i, j, k),
        load_row(c, p, i, j + 1, k),
        load_row(c, p, i, j + 2, k),
        load_row(c, p, i, j + 3, k),
    )
    w, s = y
    return (
        fma(fma(fma(scale(w[0], r0), w[1], r1), w[2], r2), w[3], r3),
        fma(fma(fma(scale(s[0], r0), s[1], r1), s[2], r2), s[3], r3),
    )


@inlined
def cell_value_gradient(c: NDArray[np.float32], p: Index, cell: Cell) -> Float64x4:
    """Evaluate (value, ∂x, ∂y, ∂z) of phase `p` in one cell; gradient per knot."""
    i, j, k, x, y, z, dz = cell
    w, s = x
    plain, slope = _sum_y(c, p, i, j, k, y)
    value, dx, dy = scale(w[0], plain), scale(s[0], plain), scale(w[0], slope)
    plain, slope = _sum_y(c, p, i + 1, j, k, y)
    value, dx, dy = fma(value, w[1], plain), fma(dx, s[1], plain), fma(dy, w[1], slope)
    plain, slope = _sum_y(c, p, i + 2, j, k, y)
    value, dx, dy = fma(value, w[2], plain), fma(dx, s[2], plain), fma(dy, w[2], slope)
    plain, slope = _sum_y(c, p, i + 3, j, k, y)
    value, dx, dy = fma(value, w[3], plain), fma(dx, s[3], plain), fma(dy, w[3], slope)
    return horizontal_sums(multiply(z, value), multiply(z, dx), multiply(z, dy), multiply(dz, value))


@inlined
def _value_y(c: NDArray[np.float32], p: Index, i: Index, j: Index, k: Index, w: Weights4) -> Float64x4:
    """Compute Σ_b B_b(y) of the rows of one slice."""
    r0, r1, r2, r3 = (
        load_row(c, p, i, j, k),
        load_row(c, p, i, j + 1, k),
        load_row(c, p, i, j + 2, k),
        load_row(c, p, i, j + 3, k),
    )
    return fma(fma(fma(scale(w[0], r0), w[1], r1), w[2], r2), w[3], r3)


@inlined
def cell_value(c: NDArray[np.float32], p: Index, cell: Cell) -> float:
    """Evaluate the value of phase `p` in one cell: a quarter of the sums of `cell_value_gradient`."""
    i, j, k, x, y, z, _ = cell
    w, by_y = x[0], y[0]
    total = scale(w[0], _value_y(c, p, i, j, k, by_y))
    total = fma(total, w[1], _value_y(c, p, i + 1, j, k, by_y))
    total = fma(total, w[2], _value_y(c, p, i + 2, j, k, by_y))
    total = fma(total, w[3], _value_y(c, p, i + 3, j, k, by_y))
    a, b, d, e = unpack(multiply(z, total))
    value: float = (a + b) + (d + e)
    return value


@inlined
def spline_at(
    coefficients: NDArray[np.float32],
    origin_mm: FloatArray,
    per_knot: float,
    phase: int,
    q: tuple[float, float, float],
) -> tuple[int, float, float, float, float]:
    """Evaluate status, distance and gradient of one phase at a point `q` (mm, model frame); NaN unless OK."""
    cells = (coefficients.shape[1] - 3, coefficients.shape[2] - 3, coefficients.shape[3] - 3)
    u = (q[0] - origin_mm[0]) * per_knot
    v = (q[1] - origin_mm[1]) * per_knot
    w = (q[2] - origin_mm[2]) * per_knot
    if not inside_box(u, v, w, cells):
        status = code.OUT_OF_VOLUME if math.isfinite(u + v + w) else code.FAULT
        return status, math.nan, math.nan, math.nan, math.nan
    d, gx, gy, gz = unpack(cell_value_gradient(coefficients, np.uintp(phase), find_cell(u, v, w, cells)))
    return code.OK, d, gx * per_knot, gy * per_knot, gz * per_knot


@kernel
def spline_batch(
    coefficients: NDArray[np.float32],
    origin_mm: FloatArray,
    knot_mm: float,
    phase: int,
    xyz_mm: FloatArray,
    value: FloatArray,
    gradient: FloatArray,
    status: IntArray,
) -> None:
    """Evaluate distance and gradient of one phase at many points, into the caller's buffers.

    Args:
        coefficients: (n, cx, cy, cz) mm.
        origin_mm: (3,); knot_mm: knot pitch.
        phase: index of the phase.
        xyz_mm: (k, 3) points in the model's frame.
        value, gradient, status: (k,), (k, 3), (k,) outputs; NaN if the status is not OK.
    """
    per_knot = 1.0 / knot_mm
    for n in range(len(xyz_mm)):
        q = (xyz_mm[n, 0], xyz_mm[n, 1], xyz_mm[n, 2])
        status[n], value[n], gradient[n, 0], gradient[n, 1], gradient[n, 2] = spline_at(
            coefficients, origin_mm, per_knot, phase, q
        )
