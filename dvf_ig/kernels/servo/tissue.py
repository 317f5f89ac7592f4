"""Force of tissue on a tool at the servo: stiffness, damping, friction and texture by its label.

The foot point q − (d/|∇d|) n on the moving surface is the proxy of a frictionless contact. Motion and labels
map it to the material at end-diastole, X. With depth p, its rate ṗ, and k, b, μ, τ of the material there

    F_n = k p (1 + τ w(X)) + b ṗ, never negative,    F_t = −k_t e, |F_t| ≤ μ F_n

e leads from an anchor in the material to X, turned from end-diastole to now to first order; if it is too
long the anchor slides after. Sticking, so, holds to the beating surface.

Source: Salisbury and Tarr 1997 (friction of a proxy); Hayward and Armstrong 2000 (the sliding anchor).
"""

import math
from typing import Any

from dvf_ig.core import FloatArray
from dvf_ig.kernels import status as code
from dvf_ig.kernels.compiled import inlined
from dvf_ig.kernels.dynamic import contracted_by_mm, field_at
from dvf_ig.kernels.fixture_field import CONTRACTION, TIMES
from dvf_ig.kernels.lanes import fma, load_row, pack, scale, unpack
from dvf_ig.kernels.laws import direction_certainty
from dvf_ig.kernels.phase import phase_bracket
from dvf_ig.kernels.place import phase_at, pose_at, status_at
from dvf_ig.kernels.pose_and_phase import distance_rate_and_sigma
from dvf_ig.kernels.vectors import Vector, dot
from dvf_ig.kernels.warp import contraction_at, known_share, mixed, spline_at, through_warp, warp_at

from .fixtures import clear
from .tip import in_model

TEXTURE_MM = 3.0
"""Wavelength of texture, a sum of three waves along the axes of the material."""
ONSET_MM = 0.5
"""Depth over which damping comes in, so that a contact does not begin with a step."""


@inlined
def _cell(mm: float, origin_mm: float, per_mm: float, last: int) -> tuple[int, float]:
    """Find the voxel before a coordinate and the share of the next; beyond the grid its border's."""
    u = min(max((mm - origin_mm) * per_mm, 0.0), float(last))
    begin = min(int(u), last - 1)
    return begin, u - begin


@inlined
def _properties(bound: Any, x: Vector) -> tuple[float, float, float, float]:
    """Interpolate (k, b, μ, τ) linearly at a place of the material."""
    of, values = bound.tissue[0], bound.tissue_properties
    i, u = _cell(x[0], of.label_origin_mm[0], of.label_per_mm, values.shape[0] - 1)
    j, v = _cell(x[1], of.label_origin_mm[1], of.label_per_mm, values.shape[1] - 1)
    k, w = _cell(x[2], of.label_origin_mm[2], of.label_per_mm, values.shape[2] - 1)
    total = pack(0.0, 0.0, 0.0, 0.0)
    for a in range(2):
        along_x = u if a == 1 else 1.0 - u
        for b in range(2):
            weight = along_x * (v if b == 1 else 1.0 - v)
            total = fma(total, weight * (1.0 - w), load_row(values, i + a, j + b, k, 0))
            total = fma(total, weight * w, load_row(values, i + a, j + b, k + 1, 0))
    stiffness, damping, friction, texture = unpack(total)
    return stiffness, damping, friction, texture


@inlined
def _material(bound: Any, foot: Vector, phi: float) -> tuple[Vector, Any]:
    """Map a place of the model at a phase to the material, with the three rows (0, ∂m_c/∂x…) there.

    A heart that contracts g times as far has moved g times as far.
    """
    motion, times = bound.tissue_motion, bound.packed[0]
    first, second, alpha, _ = phase_bracket(times, TIMES, len(motion), phi)
    m0, x0, y0, z0 = spline_at(motion, first, bound.tissue[0], foot)
    m1, x1, y1, z1 = spline_at(motion, second, bound.tissue[0], foot)
    g = times[CONTRACTION]
    mx, my, mz, _ = unpack(scale(g, mixed(alpha, m0, m1)))
    slopes = (
        unpack(scale(g, mixed(alpha, x0, x1))),
        unpack(scale(g, mixed(alpha, y0, y1))),
        unpack(scale(g, mixed(alpha, z0, z1))),
    )
    return (foot[0] - mx, foot[1] - my, foot[2] - mz), slopes


@inlined
def _stick(m: Any, of: Any, x: Vector, slopes: Any, n: Vector, largest_n: float) -> Vector:
    """Compute F_t in the model's frame; the anchor slides where it would be longer than `largest_n`."""
    if m.anchored == 0 or not largest_n > 0.0:
        m.anchored = 1
        for k in range(3):
            m.anchor_mm[k] = x[k]
        return 0.0, 0.0, 0.0
    lag = (x[0] - m.anchor_mm[0], x[1] - m.anchor_mm[1], x[2] - m.anchor_mm[2])
    along_x, along_y, along_z = slopes
    e = (
        lag[0] + along_x[0] * lag[0] + along_y[0] * lag[1] + along_z[0] * lag[2],
        lag[1] + along_x[1] * lag[0] + along_y[1] * lag[1] + along_z[1] * lag[2],
        lag[2] + along_x[2] * lag[0] + along_y[2] * lag[1] + along_z[2] * lag[2],
    )
    out = dot(e, n)
    e = (e[0] - out * n[0], e[1] - out * n[1], e[2] - out * n[2])
    pull_n = of.stick_n_per_mm * math.sqrt(dot(e, e))
    share = 1.0
    if pull_n > largest_n:
        share = largest_n / pull_n
        for k in range(3):
            m.anchor_mm[k] = x[k] - share * lag[k]
    f = -share * of.stick_n_per_mm
    return f * e[0], f * e[1], f * e[2]


@inlined
def tissue_force(bound: Any, scratch: Any, inputs: Any, t_s: float, xyz: FloatArray, status: int) -> int:
    """Force of the touched tissue at one place and time into `composed`; the rest as `fixtures_force`."""
    m, sample, composed = scratch.memory[0], scratch.sample[0], scratch.composed[0]
    p = inputs.pose_and_phase
    if status == code.OK:
        status = status_at(p, t_s, xyz[0] + xyz[1] + xyz[2])
    clear(sample, composed)
    if status != code.OK:
        m.anchored = 0
        return status
    pose, phase = pose_at(p, t_s), phase_at(p, t_s)
    at = in_model(pose, xyz)
    variance, by_warp, share = 0.0, 0.0, 1.0
    contraction, per_s = contraction_at(p, t_s)
    bound.packed[0, CONTRACTION] = contraction
    if p.warped != 0.0:
        at, slope, variance, moving = warp_at(scratch.warps, p, t_s, at)
        share = known_share(variance)
        status, d, g, rate = field_at(bound.linear, bound.packed[0], at, phase[0])
        if status == code.OK:
            distance_mm, gradient = through_warp(slope, d, g)
            by_warp = dot(g, moving)
            if per_s != 0.0:
                by_warp -= per_s * contracted_by_mm(bound.linear, bound.packed[0], at, phase[0])
    else:
        status, d, g, rate = field_at(bound.linear, bound.packed[0], at, phase[0])
        distance_mm, gradient = d, g
    if status == code.OK and share == 0.0:
        status = code.UNSEEN
    if status != code.OK:
        m.anchored = 0
        return status
    turned_back = (dot(pose[0], gradient), dot(pose[1], gradient), dot(pose[2], gradient))
    sample.distance_mm, sample.rate_mm_per_cycle = distance_mm, rate
    sample.gradient[0], sample.gradient[1], sample.gradient[2] = turned_back
    by_place, sigma = distance_rate_and_sigma(p, pose, phase, xyz, turned_back, rate)
    sample.distance_rate_mm_s = by_place - by_warp
    sample.sigma_mm = math.sqrt(sigma * sigma + variance)
    norm, model_norm = math.sqrt(dot(gradient, gradient)), math.sqrt(dot(g, g))
    certainty = direction_certainty(norm) * share
    if not (distance_mm > 0.0 and certainty > 0.0):
        m.anchored = 0
        return status
    # n of the patient; the foot point's place in the model by the model's own gradient
    n = (gradient[0] / norm, gradient[1] / norm, gradient[2] / norm)
    back = d / (model_norm * model_norm)
    foot = (at[0] - back * g[0], at[1] - back * g[1], at[2] - back * g[2])
    x, slopes = _material(bound, foot, phase[0])
    stiffness, damping, friction, texture = _properties(bound, x)
    depth = distance_mm / model_norm
    wave = 2.0 * math.pi / TEXTURE_MM
    rough = 1.0 + texture * (math.sin(wave * x[0]) + math.sin(wave * x[1]) + math.sin(wave * x[2])) / 3.0
    along = dot(turned_back, (m.tool_mm_s[0], m.tool_mm_s[1], m.tool_mm_s[2])) + sample.distance_rate_mm_s
    damped = damping * min(depth / ONSET_MM, 1.0) * along / norm
    # within the cap here, so that the passivity observer refers to what is sent
    normal_n = min(certainty * max(0.0, stiffness * depth * rough + damped), bound.settings[0].cap_n)
    side = _stick(m, bound.tissue[0], x, slopes, n, friction * normal_n)
    f = (side[0] - normal_n * n[0], side[1] - normal_n * n[1], side[2] - normal_n * n[2])
    for k in range(3):
        composed.forbidden_n[k] = dot(pose[k], f)
    if not math.isfinite(f[0] + f[1] + f[2]):
        for k in range(3):
            composed.forbidden_n[k] = 0.0
        return code.FAULT
    return status
