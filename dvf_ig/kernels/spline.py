"""Cubic B-spline value and gradient at a point (Ren 2008, eq. 1, degree 3 along each axis).

With u = (q − origin)/knot and i = floor(u), d(q) = Σ c[i+a, j+b, k+e] B_a(x) B_b(y) B_e(z), a, b, e = 0 … 3.
Values and derivatives share their loads: each coefficient is read once. Sums over y come first, in four lanes
along z (contiguous in memory), then sums over x, then over z.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, IntArray

from . import status as code
from .compiled import inlined, kernel

Lanes = tuple[float, float, float, float]

Index = Any
"""np.uintp: indices that cannot be negative spare the compiled code a wrap-around test."""


@inlined
def cubic_weights(t: float) -> tuple[Lanes, Lanes]:
    """B_0 … B_3 and their derivatives at t in [0, 1]; the fourth follows from the sum being 1 (0)."""
    rest = 1.0 - t
    b0 = rest * rest * rest / 6.0
    b1 = (3.0 * t - 6.0) * t * t / 6.0 + 2.0 / 3.0
    b3 = t * t * t / 6.0
    d0 = -0.5 * rest * rest
    d1 = (1.5 * t - 2.0) * t
    d3 = 0.5 * t * t
    return (b0, b1, 1.0 - b0 - b1 - b3, b3), (d0, d1, -d0 - d1 - d3, d3)


@inlined
def inside_box(u: float, v: float, w: float, cells: tuple[int, int, int]) -> bool:
    """Whether knot coordinates lie where the spline is defined; False for NaN."""
    return 0.0 <= u <= cells[0] and 0.0 <= v <= cells[1] and 0.0 <= w <= cells[2]


@inlined
def cell_of(u: float, cells: int) -> Index:
    """floor(u) for 0 <= u <= cells; the far border belongs to the last cell."""
    return min(np.uintp(u), np.uintp(cells - 1))


@inlined
def _sum_y(c: NDArray[np.float32], p: Index, i: Index, j: Index, k: Index, w: Lanes) -> float:
    total: float = (
        w[0] * c[p, i, j, k] + w[1] * c[p, i, j + 1, k] + w[2] * c[p, i, j + 2, k] + w[3] * c[p, i, j + 3, k]
    )
    return total


@inlined
def _lanes_y(c: NDArray[np.float32], p: Index, i: Index, j: Index, k: Index, w: Lanes) -> Lanes:
    return (
        _sum_y(c, p, i, j, k, w),
        _sum_y(c, p, i, j, k + 1, w),
        _sum_y(c, p, i, j, k + 2, w),
        _sum_y(c, p, i, j, k + 3, w),
    )


@inlined
def _dot(w: Lanes, v: Lanes) -> float:
    return w[0] * v[0] + w[1] * v[1] + w[2] * v[2] + w[3] * v[3]


@inlined
def _sum_x(w: Lanes, a: Lanes, b: Lanes, c: Lanes, d: Lanes) -> Lanes:
    return (
        w[0] * a[0] + w[1] * b[0] + w[2] * c[0] + w[3] * d[0],
        w[0] * a[1] + w[1] * b[1] + w[2] * c[1] + w[3] * d[1],
        w[0] * a[2] + w[1] * b[2] + w[2] * c[2] + w[3] * d[2],
        w[0] * a[3] + w[1] * b[3] + w[2] * c[3] + w[3] * d[3],
    )


@inlined
def cell_value_gradient(
    c: NDArray[np.float32],
    p: Index,
    cell: tuple[Index, Index, Index],
    x: tuple[Lanes, Lanes],
    y: tuple[Lanes, Lanes],
    z: tuple[Lanes, Lanes],
) -> tuple[float, float, float, float]:
    """Value and gradient (per knot) of phase `p` in one cell, given the weights along each axis."""
    i, j, k = cell
    a = _lanes_y(c, p, i, j, k, y[0])
    b = _lanes_y(c, p, i + 1, j, k, y[0])
    e = _lanes_y(c, p, i + 2, j, k, y[0])
    f = _lanes_y(c, p, i + 3, j, k, y[0])
    dy = _sum_x(
        x[0],
        _lanes_y(c, p, i, j, k, y[1]),
        _lanes_y(c, p, i + 1, j, k, y[1]),
        _lanes_y(c, p, i + 2, j, k, y[1]),
        _lanes_y(c, p, i + 3, j, k, y[1]),
    )
    value = _sum_x(x[0], a, b, e, f)
    dx = _sum_x(x[1], a, b, e, f)
    return _dot(z[0], value), _dot(z[0], dx), _dot(z[0], dy), _dot(z[1], value)


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
    """Distance and gradient of one phase at many points, into the caller's buffers.

    Args:
        coefficients: (n, cx, cy, cz) mm.
        origin_mm: (3,); knot_mm: knot pitch.
        phase: index of the phase.
        xyz_mm: (k, 3) points in the model's frame.
        value, gradient, status: (k,), (k, 3), (k,) outputs; NaN where the status is not OK.
    """
    per_knot = 1.0 / knot_mm
    cells = (coefficients.shape[1] - 3, coefficients.shape[2] - 3, coefficients.shape[3] - 3)
    p = np.uintp(phase)
    for n in range(len(xyz_mm)):
        u = (xyz_mm[n, 0] - origin_mm[0]) * per_knot
        v = (xyz_mm[n, 1] - origin_mm[1]) * per_knot
        w = (xyz_mm[n, 2] - origin_mm[2]) * per_knot
        if not inside_box(u, v, w, cells):
            status[n] = code.OUT_OF_VOLUME if np.isfinite(u + v + w) else code.FAULT
            value[n] = np.nan
            gradient[n, 0] = gradient[n, 1] = gradient[n, 2] = np.nan
            continue
        i, j, k = cell_of(u, cells[0]), cell_of(v, cells[1]), cell_of(w, cells[2])
        d, gx, gy, gz = cell_value_gradient(
            coefficients, p, (i, j, k), cubic_weights(u - i), cubic_weights(v - j), cubic_weights(w - k)
        )
        status[n] = code.OK
        value[n] = d
        gradient[n, 0] = gx * per_knot
        gradient[n, 1] = gy * per_knot
        gradient[n, 2] = gz * per_knot
