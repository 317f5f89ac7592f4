"""Forbidden regions on the shaft of a tool, where it reaches deepest.

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
from dvf_ig.kernels.fixture_field import LAW, Output, no_output
from dvf_ig.kernels.place import pose_at
from dvf_ig.kernels.pose_and_phase import rotated_by
from dvf_ig.kernels.vectors import Vector, dot, vector_at
from dvf_ig.kernels.warp import known_share, output_through, warp_at
from dvf_ig.kernels.worst_phase import worst_phase_force

from .borrowed import borrowed_from
from .parts import note_field
from .tip import surface_coefficients

PITCH_MM = 5.0
"""Largest distance between two samples: 0.16 mm at a radius of 20 mm."""
BAND_MM = 0.5
"""Places that reach less deep by this much do not count."""
STEEPEST = 1.25
"""Largest change of distance per mm: of a fitted field, and through a change of shape, it is not just 1."""
SURE_SHARE = 1e-9
SHORTEST_MM = 1.0
"""A tip closer to the trocar has no direction towards it."""


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


@inlined
def keeps_out(bound: Any, i: int) -> bool:
    """Whether fixture `i` is a forbidden region, which acts on the whole tool; others act on the tip."""
    return bool(bound.settings[0].fixtures.forbidden[i] != 0.0 and bound.packed[i, LAW + 1] > 0.0)


@kernel
def find_shaft(tool: Any, inputs: Any, xyz: FloatArray, shaft: FloatArray) -> int:
    """Write the axis from the tip to the handle and the length to the trocar; OK if it is known."""
    if tool.trocar == 0:
        shaft[0], shaft[1], shaft[2] = inputs.tool_axis[0], inputs.tool_axis[1], inputs.tool_axis[2]
        shaft[3] = math.inf
        size = dot(vector_at(shaft, 0), vector_at(shaft, 0))
        return code.OK if 0.99 < size < 1.01 else code.STALE_TOOL
    for k in range(3):
        shaft[k] = tool.trocar_mm[k] - xyz[k]
    shaft[3] = math.sqrt(dot(vector_at(shaft, 0), vector_at(shaft, 0)))
    if not shaft[3] >= SHORTEST_MM:
        return code.OUT_OF_VOLUME
    for k in range(3):
        shaft[k] /= shaft[3]
    return code.OK


@inlined
def wall_of_shaft(
    bound: Any, scratch: Any, inputs: Any, t_s: float, place: Vector, phi: float, i: int
) -> tuple[Output, float]:
    """Wall `i` on the shaft in `scratch`, and how far above the tip it is met; phi as of `wall_on_shaft`."""
    p = inputs.pose_and_phase
    return wall_on_shaft(
        surface_coefficients(bound, i),
        bound.packed[i],
        bound.settings[0].tool,
        place,
        rotated_by(pose_at(p, t_s), vector_at(scratch.shaft, 0)),
        scratch.shaft[3],
        phi,
        (scratch.warps, p, t_s),
        scratch.depths,
    )


@kernel
def on_shaft(
    bound_at: Any, scratch_at: Any, inputs: Any, t_s: float, place: Vector, phi: float, first: Output
) -> tuple[Output, float]:
    """Put the forces of forbidden regions on the shaft in place of those on the tip.

    Args:
        bound_at, scratch_at: of `servo_tick`.
        first: output of `forces_on_tip` at the tip.
    Returns:
        output of the first fixture within reach, and how far above the tip it is met.
    """
    bound, scratch = borrowed_from(bound_at), borrowed_from(scratch_at)
    of, met_mm, begun = bound.settings[0].fixtures, 0.0, False
    for i in range(len(bound.packed)):
        if not keeps_out(bound, i):
            begun = begun or of.far_outside[i] == 0
            continue
        output, at_mm = wall_of_shaft(bound, scratch, inputs, t_s, place, phi, i)
        if output[0] == code.OUT_OF_VOLUME and of.far_outside[i] != 0:
            continue
        if output[0] != code.OK:
            return output, 0.0
        scratch.forces[i, 0], scratch.forces[i, 1], scratch.forces[i, 2] = output[1]
        if of.others != 0:
            axis = rotated_by(pose_at(inputs.pose_and_phase, t_s), vector_at(scratch.shaft, 0))
            note_field(scratch.fields, i, at_tip(output[3], axis, 1.0 - at_mm / scratch.shaft[3]), output[4])
        if not begun:
            first, met_mm, begun = output, at_mm, True
    return first, met_mm


@inlined
def take_gradient(sample: Any, shaft: FloatArray, met_mm: float, gradient: Vector) -> None:
    """Set the gradient by the tip's place of a distance met above the tip, if it is."""
    if met_mm > 0.0:
        gradient = at_tip(gradient, vector_at(shaft, 0), 1.0 - met_mm / shaft[3])
    sample.gradient[0], sample.gradient[1], sample.gradient[2] = gradient


@inlined
def met_place(scratch: Any, xyz: FloatArray, met_mm: float) -> FloatArray:
    """Place (3,) of the tool that meets the first fixture, tracker frame."""
    if met_mm == 0.0:
        return xyz
    place: FloatArray = scratch.vectors[7]
    for k in range(3):
        place[k] = xyz[k] + met_mm * scratch.shaft[k]
    return place
