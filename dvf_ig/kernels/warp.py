"""A change of the heart's shape between the pose and the phases' splines (`dvf_ig.core.Warp`).

With q' = q − m(q) the distance is d'(q, φ) = d(q', φ), its gradient ∇d' = (I − Dm)ᵀ ∇d, and while one warp
gives way to another ∂d'/∂t has the part −∇d·ṁ. Where the wall's place is known too badly there is no force.
"""

import math
from typing import Any

from .compiled import inlined
from .fixture_field import Output
from .lanes import Float64x4, fma, load_row, pack, scale, unpack
from .spline import cubic_weights, knot_cell
from .vectors import Vector, dot

SURE_SIGMA_MM, LARGEST_SIGMA_MM = 2.0 / 1.96, 2.5 / 1.96
"""Standard deviation of the wall's place up to which a force is whole, and from which there is none: the wall
lies within 2.5 mm of its estimate in 95 of 100 places. Here, for compiled kernels are kept until a source of
theirs changes."""
SURE_MM2, LARGEST_MM2 = SURE_SIGMA_MM**2, LARGEST_SIGMA_MM**2

Slope = Any
"""Rows (0, ∂m_c/∂x, ∂m_c/∂y, ∂m_c/∂z) for c = x, y, z; None of a heart that has kept its shape."""


@inlined
def _coordinate(q_mm: float, origin_mm: float, per_mm: float, cells: int) -> tuple[float, float]:
    """Compute the knot coordinate within the grid, and its change per mm: 0 beyond it, where m stays."""
    u = (q_mm - origin_mm) * per_mm
    if not u > 0.0:  # NaN as well
        return 0.0, 0.0
    return (u, per_mm) if u < cells else (float(cells), 0.0)


@inlined
def spline_at(warps: Any, slot: Any, p: Any, q: Vector) -> tuple[Float64x4, Float64x4, Float64x4, Float64x4]:
    """Evaluate (m, variance) of one warp and its three derivatives per mm.

    Args:
        p: record with `warp_origin_mm` and `warp_per_mm`.
    """
    cells = warps.shape[1] - 3
    u, per_x = _coordinate(q[0], p.warp_origin_mm[0], p.warp_per_mm, cells)
    v, per_y = _coordinate(q[1], p.warp_origin_mm[1], p.warp_per_mm, cells)
    w, per_z = _coordinate(q[2], p.warp_origin_mm[2], p.warp_per_mm, cells)
    i, j, k = knot_cell(u, cells), knot_cell(v, cells), knot_cell(w, cells)
    x, dx = cubic_weights(u - i)
    y, dy = cubic_weights(v - j)
    z, dz = cubic_weights(w - k)
    wx, sx = unpack(x), unpack(scale(per_x, dx))
    wy, sy = unpack(y), unpack(scale(per_y, dy))
    wz, sz = unpack(z), unpack(scale(per_z, dz))
    nothing = pack(0.0, 0.0, 0.0, 0.0)
    m, along_x, along_y, along_z = nothing, nothing, nothing, nothing
    for a in range(4):
        plain, slope_y, slope_z = nothing, nothing, nothing
        for b in range(4):
            r0 = load_row(warps, slot, i + a, j + b, 4 * k)
            r1 = load_row(warps, slot, i + a, j + b, 4 * k + 4)
            r2 = load_row(warps, slot, i + a, j + b, 4 * k + 8)
            r3 = load_row(warps, slot, i + a, j + b, 4 * k + 12)
            sum_z = fma(fma(fma(scale(wz[0], r0), wz[1], r1), wz[2], r2), wz[3], r3)
            by_z = fma(fma(fma(scale(sz[0], r0), sz[1], r1), sz[2], r2), sz[3], r3)
            plain, slope_y = fma(plain, wy[b], sum_z), fma(slope_y, sy[b], sum_z)
            slope_z = fma(slope_z, wy[b], by_z)
        m, along_x = fma(m, wx[a], plain), fma(along_x, sx[a], plain)
        along_y, along_z = fma(along_y, wx[a], slope_y), fma(along_z, wx[a], slope_z)
    return m, along_x, along_y, along_z


@inlined
def mixed(weight: float, a: Float64x4, b: Float64x4) -> Float64x4:
    """Compute (1 − weight) a + weight b."""
    return fma(scale(1.0 - weight, a), weight, b)


@inlined
def warp_at(warps: Any, p: Any, t_s: float, q: Vector) -> tuple[Vector, Slope, float, Vector]:
    """Compute q', Dm, the variance of the wall's place, and ṁ (mm/s).

    Args:
        warps: (2, COEFFICIENTS, COEFFICIENTS, 4 COEFFICIENTS) float32 coefficients before and after a motion.
        p: POSE_AND_PHASE of a heart that has changed its shape.
        q: point at the registered pose, model frame.
    """
    m, x, y, z = spline_at(warps, 1, p, q)
    rate = pack(0.0, 0.0, 0.0, 0.0)
    if t_s < p.warp_end_s:
        before, x0, y0, z0 = spline_at(warps, 0, p, q)
        share = 0.0
        if t_s > p.warp_start_s:
            per_s = 1.0 / (p.warp_end_s - p.warp_start_s)
            share = (t_s - p.warp_start_s) * per_s
            rate = scale(per_s, fma(m, -1.0, before))
        m, x, y, z = (
            mixed(share, before, m),
            mixed(share, x0, x),
            mixed(share, y0, y),
            mixed(share, z0, z),
        )
    mx, my, mz, variance = unpack(m)
    ax, ay, az = unpack(x), unpack(y), unpack(z)
    slope = (
        pack(0.0, ax[0], ay[0], az[0]),
        pack(0.0, ax[1], ay[1], az[1]),
        pack(0.0, ax[2], ay[2], az[2]),
    )
    rx, ry, rz, _ = unpack(rate)
    return (q[0] - mx, q[1] - my, q[2] - mz), slope, max(variance, 0.0), (rx, ry, rz)


@inlined
def contraction_at(p: Any, t_s: float) -> tuple[float, float]:
    """Compute how many times as far as in the model the heart contracts, and how fast that changes (1/s).

    Args:
        p: POSE_AND_PHASE.
    """
    if p.warped == 0.0:
        return 1.0, 0.0
    before, after = p.contraction[0], p.contraction[1]
    if not t_s < p.warp_end_s or before == after:
        return after, 0.0
    if not t_s > p.warp_start_s:
        return before, 0.0
    per_s = (after - before) / (p.warp_end_s - p.warp_start_s)
    return before + (t_s - p.warp_start_s) * per_s, per_s


@inlined
def warped(slope: Slope, field: Float64x4) -> Float64x4:
    """Turn (distance, ∇d) at q' into (distance, ∇d') at q."""
    if slope is None:
        return field
    _, gx, gy, gz = unpack(field)
    return fma(fma(fma(field, -gx, slope[0]), -gy, slope[1]), -gz, slope[2])


@inlined
def warped_vector(slope: Slope, v: Vector) -> Vector:
    """Compute (I − Dm)ᵀ v."""
    _, x, y, z = unpack(warped(slope, pack(0.0, v[0], v[1], v[2])))
    return x, y, z


@inlined
def through_warp(slope: Slope, distance_mm: float, gradient: Vector) -> tuple[float, Vector]:
    """Turn distance and ∇d at q' into the distance to the wall at q, to first order, and ∇d'."""
    x, y, z = warped_vector(slope, gradient)
    stretch = math.sqrt(dot(gradient, gradient) / (x * x + y * y + z * z))
    return distance_mm * stretch, (x, y, z)


@inlined
def output_through(output: Output, slope: Slope, share: float, moving: Vector) -> tuple[Output, float]:
    """Turn the output at q' into that at q, with a share of its force; also −∂d/∂t by the warp's motion."""
    status, force, d, gradient, rate = output
    d, turned = through_warp(slope, d, gradient)
    force = (share * force[0], share * force[1], share * force[2])
    return (status, force, d, turned, rate), dot(gradient, moving)


@inlined
def known_share(variance_mm2: float) -> float:
    """Share of the force that remains where the wall's place has this variance."""
    part = (LARGEST_MM2 - variance_mm2) / (LARGEST_MM2 - SURE_MM2)
    part = min(max(part, 0.0), 1.0)
    return part * part * (3.0 - 2.0 * part)
