"""A wall's force on the shaft of a tool, where it reaches deepest.

The shaft is sampled at s_j = j·pitch from the tip on, the tip being s_0. With d* the largest of the distances
d_j, the force is that of the deepest place, or a mean of several that reach about equally deep:

    F = Σ w_j F_j / Σ w_j,    w_j = max(0, 1 − (d* − d_j)/BAND_MM)²

so that nothing jumps where the deepest place does. A distance changes by at most STEEPEST per mm, so samples
after a far one are left out unevaluated, and none of them had a weight. The deepest place lies at most
pitch²/(8R) deeper than the deepest sample, R the radius of curvature of the wall along the shaft.

Through a trocar at P the shaft turns about it: a place s above the tip moves along with it, and sideways by
1 − s/|P − tip| of it. Force and gradient are those on the tip that do the same work.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray
from dvf_ig.kernels import status as code
from dvf_ig.kernels.compiled import inlined, kernel
from dvf_ig.kernels.dynamic import distance_at, force_at
from dvf_ig.kernels.fixture_field import Output, no_output
from dvf_ig.kernels.vectors import Vector, dot
from dvf_ig.kernels.warp import known_share, output_through, warp_at
from dvf_ig.kernels.worst_phase import worst_phase_force

PITCH_MM = 5.0
"""Largest distance between two samples: 0.16 mm at a radius of 20 mm."""
BAND_MM = 0.5
"""Places that reach less deep by this much do not count."""
STEEPEST = 1.25
"""Largest change of distance per mm: of a fitted field, and through a change of shape, it is not just 1."""
SURE_SHARE = 1e-9


@inlined
def shaft_place(tip: Vector, axis: Vector, s_mm: float) -> Vector:
    """Compute the place `s_mm` above the tip."""
    return tip[0] + s_mm * axis[0], tip[1] + s_mm * axis[1], tip[2] + s_mm * axis[2]


@inlined
def at_tip(v: Vector, axis: Vector, sideways: float) -> Vector:
    """Scale the part of a vector across the axis."""
    along = (1.0 - sideways) * dot(v, axis)
    return (
        along * axis[0] + sideways * v[0],
        along * axis[1] + sideways * v[1],
        along * axis[2] + sideways * v[2],
    )


@kernel
def _wall_at(coefficients: NDArray[np.float32], f: FloatArray, q: Vector, phi: float, through: Any) -> Output:
    """Output of a wall at one place.

    Args:
        through: (warps, pose and phase, time): the change of shape, if the heart has one.
    """
    if through[1].warped == 0.0:
        if math.isnan(phi):
            return worst_phase_force(coefficients, f, q, None)
        return force_at(coefficients, f, q, phi, None)
    at, slope, variance, _ = warp_at(through[0], through[1], through[2], q)
    share = known_share(variance)
    if share == 0.0:
        return no_output(code.UNSEEN)
    if math.isnan(phi):
        output = worst_phase_force(coefficients, f, at, slope)
    else:
        output = force_at(coefficients, f, at, phi, slope)
    if output[0] != code.OK:
        return output
    return output_through(output, slope, share, (0.0, 0.0, 0.0))[0]


@inlined
def _depth_at(coefficients: NDArray[np.float32], f: FloatArray, q: Vector, phi: float, through: Any) -> float:
    """Distance at one place; −∞ if there is none."""
    if through[1].warped == 0.0 and not math.isnan(phi):
        return distance_at(coefficients, f, q, phi)
    d = _wall_at(coefficients, f, q, phi, through)[2]
    return d if math.isfinite(d) else -math.inf


@inlined
def _sample_depths(
    coefficients: NDArray[np.float32],
    f: FloatArray,
    tool: Any,
    tip: Vector,
    axis: Vector,
    length_mm: float,
    phi: float,
    through: Any,
    depths: FloatArray,
) -> float:
    """Fill the samples' distances, −∞ where no weight can be; the largest."""
    deepest, pitch = -math.inf, tool.pitch_mm
    j = 0
    while j < tool.samples:
        s_mm = j * pitch
        d = -math.inf
        if s_mm <= length_mm:
            d = _depth_at(coefficients, f, shaft_place(tip, axis, s_mm), phi, through)
        depths[j] = d
        j += 1
        deepest = max(deepest, d)
        if d > -math.inf:
            far = (deepest - BAND_MM - d) / (STEEPEST * pitch)
            while far >= 1.0 and j < tool.samples:
                depths[j] = -math.inf
                far -= 1.0
                j += 1
    return deepest


@kernel
def wall_on_shaft(
    coefficients: NDArray[np.float32],
    f: FloatArray,
    tool: Any,
    tip: Vector,
    axis: Vector,
    inside_mm: float,
    phi: float,
    through: Any,
    depths: FloatArray,
) -> tuple[Output, float]:
    """Output of a forbidden region on a shaft, and how far above the tip it is met.

    Args:
        coefficients, f: of the wall.
        tool: TOOL of `layout`.
        tip, axis: in the model's frame; the axis is the unit vector from the tip to the handle.
        inside_mm: from the tip to the trocar; infinite without one.
        phi: model phase; NaN: the wall at its worst one. No flag states it, since numba compiles a kernel
            again for each literal one.
        through: as of `_wall_at`.
        depths: (MOST_SAMPLES,) working space.
    Returns:
        force as at the tip (`at_tip`), gradient as at the place that is met; OUT_OF_VOLUME if no place of the
        shaft is in the wall's box.
    """
    length_mm = min(tool.shaft_mm * (1.0 + SURE_SHARE), inside_mm)
    deepest = _sample_depths(coefficients, f, tool, tip, axis, length_mm, phi, through, depths)
    if deepest == -math.inf:
        # also of a place that is no number
        return _wall_at(coefficients, f, tip, phi, through), 0.0
    total, unseen, met, distance, rate = 0.0, 0.0, 0.0, 0.0, 0.0
    fx = fy = fz = gx = gy = gz = 0.0
    for j in range(tool.samples):
        rest = 1.0 - (deepest - depths[j]) / BAND_MM
        if not rest > 0.0:
            continue
        s_mm, w = j * tool.pitch_mm, rest * rest
        output = _wall_at(coefficients, f, shaft_place(tip, axis, s_mm), phi, through)
        if output[0] == code.UNSEEN:
            unseen += w
            continue
        if output[0] != code.OK:
            return output, 0.0
        force = at_tip(output[1], axis, 1.0 - s_mm / inside_mm)
        fx, fy, fz = fx + w * force[0], fy + w * force[1], fz + w * force[2]
        gx, gy, gz = gx + w * output[3][0], gy + w * output[3][1], gz + w * output[3][2]
        total, met, distance, rate = total + w, met + w * s_mm, distance + w * output[2], rate + w * output[4]
    if total == 0.0:
        return no_output(code.UNSEEN), 0.0
    all_ = total + unseen
    return (
        code.OK,
        (fx / all_, fy / all_, fz / all_),
        distance / total,
        (gx / total, gy / total, gz / total),
        rate / total,
    ), met / total
