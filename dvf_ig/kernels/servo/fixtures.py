"""All fixtures of a servo at one place and time, in the tracker's frame, with or without a cardiac phase.

When the phase is lost, guidance fades and walls become those of the worst phase; for 250 ms the composed
force is (1 − c) of the fixtures at the last known phase plus c of the walls at their worst phase, c a raised
cosine of the share that has passed; so it is when the phase is known again. Both are evaluated where the tool
is now. A wall at its worst phase pushes no less than at any other, so no wall gives way.
"""

import math
from typing import Any

from dvf_ig.core import FloatArray
from dvf_ig.kernels import status as code
from dvf_ig.kernels.compiled import inlined, kernel
from dvf_ig.kernels.composition import compose_forces
from dvf_ig.kernels.dynamic import force_at, forces_on_surface
from dvf_ig.kernels.fixture_field import BLEND, BLEND_PERIODIC, DEPTH, LAW, Output, no_output
from dvf_ig.kernels.path import path_force
from dvf_ig.kernels.place import Columns, Phase, phase_at, pose_at, status_at
from dvf_ig.kernels.pose_and_phase import distance_rate, distance_rate_and_sigma, rotated_by
from dvf_ig.kernels.vectors import Vector, dot, vector_at
from dvf_ig.kernels.warp import Slope, known_share, output_through, warp_at, warped_vector
from dvf_ig.kernels.worst_phase import worst_phase_force

from .borrowed import borrowed_block, borrowed_from
from .shaft import at_tip, wall_on_shaft

SHORTEST_MM = 1.0
"""A tip closer to the trocar has no direction towards it."""
NO_RATE = (0.0, 0.0, 0.0)
"""Phase, its rate and its standard deviation where a wall at its worst phase does not depend on them."""


@inlined
def clear(sample: Any, composed: Any) -> None:
    """Set no force, and a distance that is not known."""
    for k in range(3):
        composed.forbidden_n[k] = composed.guidance_n[k] = 0.0
        sample.gradient[k] = math.nan
    composed.conflict = sample.parts = 0
    sample.distance_mm = sample.rate_mm_per_cycle = math.nan
    sample.distance_rate_mm_s = sample.sigma_mm = math.nan


@inlined
def in_model(pose: Columns, p: FloatArray) -> Vector:
    """A point (3,) of the tracker's frame in the model's."""
    x, y, z, t = pose[0], pose[1], pose[2], pose[3]
    return (
        x[0] * p[0] + y[0] * p[1] + z[0] * p[2] + t[0],
        x[1] * p[0] + y[1] * p[1] + z[1] * p[2] + t[1],
        x[2] * p[0] + y[2] * p[1] + z[2] * p[2] + t[2],
    )


@inlined
def _to_tracker(pose: Columns, v: Vector) -> Vector:
    """A free vector of the model's frame in the tracker's."""
    return dot(pose[0], v), dot(pose[1], v), dot(pose[2], v)


@inlined
def _widen(packed: FloatArray, fixtures: Any, margin_mm: FloatArray) -> None:
    """Set the laws to those with the published margins."""
    for i in range(len(packed)):
        margin = margin_mm[i]
        packed[i, LAW + 1] = fixtures.base_width[i] + fixtures.widen_width[i] * margin
        packed[i, DEPTH] = fixtures.base_depth_mm[i] + fixtures.widen_depth[i] * margin


@inlined
def _turn_forces(pose: Columns, forces: FloatArray) -> None:
    """(k, 3) forces of the model's frame, in place, in the tracker's."""
    for i in range(len(forces)):
        forces[i, 0], forces[i, 1], forces[i, 2] = _to_tracker(
            pose, (forces[i, 0], forces[i, 1], forces[i, 2])
        )


@inlined
def _structure(bound: Any, i: int) -> Any:
    """Coefficients (n, cx, cy, cz) of the structure of fixture `i`."""
    of = bound.settings[0].fixtures
    shape = of.structure_shape[i]
    return borrowed_block(bound.structures, of.structure_begin[i], (shape[0], shape[1], shape[2], shape[3]))


@inlined
def _path_output(bound: Any, i: int, place: Vector, phi: float, slope: Slope) -> Output:
    of = bound.settings[0].fixtures
    output = path_force(
        bound.path_points,
        bound.path_times,
        of.path_first_point[i],
        of.path_points[i],
        of.path_first_time[i],
        of.path_phases[i],
        bound.packed[i],
        place,
        phi,
        bound.path_work,
    )
    return output[0], warped_vector(slope, output[1]), output[2], output[3], output[4]


@inlined
def _structure_output(bound: Any, i: int, place: Vector, phi: float, slope: Slope) -> Output:
    """Output of a fixture on a further structure; OK and NaN where its wall is too far away to be felt."""
    output = force_at(_structure(bound, i), bound.packed[i], place, phi, slope)
    if output[0] == code.OUT_OF_VOLUME and bound.settings[0].fixtures.far_outside[i] != 0:
        return no_output(code.OK)
    return output


@inlined
def _note_field(fields: FloatArray, i: int, gradient: Vector, rate: float) -> None:
    """Keep gradient and rate of fixture `i`, whose surface moves by itself; 0 if it is out of reach."""
    finite = math.isfinite(gradient[0] + gradient[1] + gradient[2] + rate)
    for k in range(3):
        fields[i, k] = gradient[k] if finite else 0.0
    fields[i, 3] = rate if finite else 0.0


@inlined
def _add_others(
    bound: Any,
    place: Vector,
    phi: float,
    slope: Slope,
    forces: FloatArray,
    fields: FloatArray,
    first: Output,
) -> Output:
    """Put forces of paths and further structures into `forces`; output of the first fixture within reach.

    Gradients and rates of all fixtures go to `fields`.
    """
    of, of_heart = bound.settings[0].fixtures, first
    begun = False
    for i in range(len(bound.packed)):
        begun = begun or i == of.first
        if of.apart[i] == 0:
            _note_field(fields, i, warped_vector(slope, of_heart[3]), of_heart[4])
            continue
        if of.path_points[i] != 0:
            output = _path_output(bound, i, place, phi, slope)
        else:
            output = _structure_output(bound, i, place, phi, slope)
        if output[0] != code.OK:
            return output
        forces[i, 0], forces[i, 1], forces[i, 2] = output[1]
        _note_field(fields, i, warped_vector(slope, output[3]), output[4])
        if not begun and math.isfinite(output[2]):
            first, begun = output, True
    return first


@inlined
def _forces(
    bound: Any, place: Vector, phi: float, slope: Slope, forces: FloatArray, fields: FloatArray
) -> Output:
    """Forces of all fixtures at a known phase, model frame; output of the first within reach.

    If the status of one withholds its force, the output is that of none; the heart's surface comes first.

    Args:
        place, slope: as of `dvf_ig.kernels.dynamic.force_at`.
    """
    of = bound.settings[0].fixtures
    output = forces_on_surface(
        bound.linear, bound.periodic, bound.packed, of.apart, of.first_linear, place, phi, slope, forces
    )
    if output[0] == code.OK and of.others != 0:
        output = _add_others(bound, place, phi, slope, forces, fields, output)
    return output


@inlined
def _warped_forces(
    bound: Any,
    inputs: Any,
    warps: Any,
    t_s: float,
    place: Vector,
    phi: float,
    forces: FloatArray,
    fields: FloatArray,
) -> tuple[Output, float, float]:
    """Forces as of `_forces` through the warp, variance of the wall's place, −∂d/∂t by the warp's motion.

    The output's distance and gradient are those through the warp (`through_warp`).
    """
    at, slope, variance, moving = warp_at(warps, inputs.pose_and_phase, t_s, place)
    share = known_share(variance)
    if share == 0.0:
        return no_output(code.UNSEEN), variance, 0.0
    output = _forces(bound, at, phi, slope, forces, fields)
    for i in range(len(forces)):
        for k in range(3):
            forces[i, k] *= share
    output, by_warp = output_through(output, slope, share, moving)
    return output, variance, by_warp


@kernel
def _warped_wall(
    of_model: Any, f: FloatArray, inputs: Any, warps: Any, t_s: float, place: Vector
) -> tuple[Output, float, float]:
    """`worst_phase_force` through the warp; results as of `_warped_forces`."""
    at, slope, variance, moving = warp_at(warps, inputs.pose_and_phase, t_s, place)
    share = known_share(variance)
    if share == 0.0:
        return no_output(code.UNSEEN), variance, 0.0
    output, by_warp = output_through(worst_phase_force(of_model, f, at, slope), slope, share, moving)
    return output, variance, by_warp


@inlined
def _coefficients(bound: Any, i: int) -> Any:
    """Coefficients of the surface of fixture `i`."""
    if bound.settings[0].fixtures.apart[i] != 0:
        return _structure(bound, i)
    return bound.periodic if int(bound.packed[i, BLEND]) == BLEND_PERIODIC else bound.linear


@inlined
def _keeps_out(bound: Any, i: int) -> bool:
    """Whether fixture `i` is a forbidden region, which acts on the whole tool; others act on the tip."""
    return bool(bound.settings[0].fixtures.forbidden[i] != 0.0 and bound.packed[i, LAW + 1] > 0.0)


@kernel
def _find_shaft(tool: Any, inputs: Any, xyz: FloatArray, shaft: FloatArray) -> int:
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
def _wall_on_shaft(
    bound: Any, scratch: Any, inputs: Any, t_s: float, place: Vector, phi: float, i: int
) -> tuple[Output, float]:
    """Wall `i` on the shaft in `scratch`, and how far above the tip it is met; phi as of `wall_on_shaft`."""
    p = inputs.pose_and_phase
    return wall_on_shaft(
        _coefficients(bound, i),
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
def _on_shaft(
    bound_at: Any, scratch_at: Any, inputs: Any, t_s: float, place: Vector, phi: float, first: Output
) -> tuple[Output, float]:
    """Put the forces of forbidden regions on the shaft in place of those on the tip.

    Args:
        bound_at, scratch_at: of `servo_tick`.
        first: output of `_forces` at the tip.
    Returns:
        output of the first fixture within reach, and how far above the tip it is met.
    """
    bound, scratch = borrowed_from(bound_at), borrowed_from(scratch_at)
    of, met_mm, begun = bound.settings[0].fixtures, 0.0, False
    for i in range(len(bound.packed)):
        if not _keeps_out(bound, i):
            begun = begun or of.far_outside[i] == 0
            continue
        output, at_mm = _wall_on_shaft(bound, scratch, inputs, t_s, place, phi, i)
        if output[0] == code.OUT_OF_VOLUME and of.far_outside[i] != 0:
            continue
        if output[0] != code.OK:
            return output, 0.0
        scratch.forces[i, 0], scratch.forces[i, 1], scratch.forces[i, 2] = output[1]
        if of.others != 0:
            axis = rotated_by(pose_at(inputs.pose_and_phase, t_s), vector_at(scratch.shaft, 0))
            _note_field(scratch.fields, i, at_tip(output[3], axis, 1.0 - at_mm / scratch.shaft[3]), output[4])
        if not begun:
            first, met_mm, begun = output, at_mm, True
    return first, met_mm


@inlined
def _take_gradient(sample: Any, shaft: FloatArray, met_mm: float, gradient: Vector) -> None:
    """Set the gradient by the tip's place of a distance met above the tip, if it is."""
    if met_mm > 0.0:
        gradient = at_tip(gradient, vector_at(shaft, 0), 1.0 - met_mm / shaft[3])
    sample.gradient[0], sample.gradient[1], sample.gradient[2] = gradient


@inlined
def _met_place(scratch: Any, xyz: FloatArray, met_mm: float) -> FloatArray:
    """Place (3,) of the tool that meets the first fixture, tracker frame."""
    if met_mm == 0.0:
        return xyz
    place: FloatArray = scratch.vectors[7]
    for k in range(3):
        place[k] = xyz[k] + met_mm * scratch.shaft[k]
    return place


@inlined
def _compose(bound: Any, scratch: Any, out: Any) -> None:
    of, cap_n = bound.settings[0].fixtures, bound.settings[0].cap_n
    compose_forces(scratch.forces, of.cap_n, of.forbidden, cap_n, scratch.work, scratch.order, out)


@inlined
def _note_parts(bound: Any, scratch: Any, pose: Columns, phase: Phase, xyz: FloatArray) -> int:
    """Write each fixture's share of the composed force and its surface's velocity, tracker frame; count.

    Forbidden regions were shortened equally; what composition left of the guidance is shared out by size.
    """
    of, composed, forces, count = (
        bound.settings[0].fixtures,
        scratch.composed[0],
        scratch.forces,
        len(bound.packed),
    )
    pushed = guided = before = 0.0
    for i in range(count):
        size = 0.0
        for k in range(3):
            size += forces[i, k] * forces[i, k]
        if of.forbidden[i] == 0.0:
            guided += math.sqrt(size)
    for k in range(3):
        total = 0.0
        for i in range(count):
            total += forces[i, k] if of.forbidden[i] != 0.0 else 0.0
        before += total * total
        pushed += total * composed.forbidden_n[k]
    remaining = pushed / before if before > 0.0 else 0.0
    for i in range(count):
        field = (scratch.fields[i, 0], scratch.fields[i, 1], scratch.fields[i, 2])
        square = dot(field, field)
        per = 0.0
        if square > 0.0:
            per = -distance_rate(pose, phase, xyz, field, scratch.fields[i, 3]) / square
        turned = _to_tracker(pose, field)
        share = remaining
        if of.forbidden[i] == 0.0:
            size = math.sqrt(forces[i, 0] ** 2 + forces[i, 1] ** 2 + forces[i, 2] ** 2)
            share = size / guided if guided > 0.0 else 0.0
        for k in range(3):
            scratch.part_mm_s[i, k] = per * turned[k]
            part = forces[i, k] if of.forbidden[i] != 0.0 else composed.guidance_n[k]
            scratch.part_n[i, k] = share * part
    return count


@inlined
def fixtures_force(
    bound_at: Any, scratch_at: Any, inputs: Any, t_s: float, xyz: FloatArray, status: int
) -> int:
    """All fixtures' force at one place and time into `composed`; distance, gradient, rates, σ into `sample`.

    The phase is remembered for `cross_to_walls`; while it is unknown no force comes from here.

    Args:
        bound_at, scratch_at, inputs: of `servo_tick`.
        t_s: by the session's clock; xyz: (3,) mm, tracker frame.
        status: of the inputs.
    Returns:
        status code; unless OK there is no force.
    """
    bound, scratch = borrowed_from(bound_at), borrowed_from(scratch_at)
    m, sample, composed = scratch.memory[0], scratch.sample[0], scratch.composed[0]
    if status == code.OK:
        status = status_at(inputs.pose_and_phase, t_s, xyz[0] + xyz[1] + xyz[2])
    clear(sample, composed)
    if status != code.OK:
        return status
    pose, phase = pose_at(inputs.pose_and_phase, t_s), phase_at(inputs.pose_and_phase, t_s)
    m.last_phase, m.phase_known = phase[0], 1
    _widen(bound.packed, bound.settings[0].fixtures, inputs.margin_mm)
    place, variance, by_warp = in_model(pose, xyz), 0.0, 0.0
    if inputs.pose_and_phase.warped == 0.0:
        output = _forces(bound, place, phase[0], None, scratch.forces, scratch.fields)
    else:
        output, variance, by_warp = _warped_forces(
            bound, inputs, scratch.warps, t_s, place, phase[0], scratch.forces, scratch.fields
        )
    tool, met_mm = bound.settings[0].tool, 0.0
    if output[0] == code.OK and tool.shaft_mm > 0.0:
        status = _find_shaft(tool, inputs, xyz, scratch.shaft)
        if status != code.OK:
            return status
        output, met_mm = _on_shaft(bound_at, scratch_at, inputs, t_s, place, phase[0], output)
    if output[0] != code.OK:
        return output[0]
    _turn_forces(pose, scratch.forces)
    gradient = _to_tracker(pose, output[3])
    sample.distance_mm = output[2] + tool.radius_mm
    sample.rate_mm_per_cycle = output[4] if bound.settings[0].fixtures.path_points[0] == 0 else math.nan
    _take_gradient(sample, scratch.shaft, met_mm, gradient)
    _compose(bound, scratch, composed)
    if bound.settings[0].fixtures.others != 0:
        sample.parts = _note_parts(bound, scratch, pose, phase, xyz)
    met = _met_place(scratch, xyz, met_mm)
    by_place, sigma = distance_rate_and_sigma(inputs.pose_and_phase, pose, phase, met, gradient, output[4])
    sample.distance_rate_mm_s = by_place
    sample.sigma_mm = sigma
    if inputs.pose_and_phase.warped != 0.0:
        sample.distance_rate_mm_s = by_place - by_warp
        sample.sigma_mm = math.sqrt(sigma * sigma + variance)
    return code.OK


@kernel
def _step_share(m: Any, status: int, step: float) -> float:
    """c after one more tick; without force there is nothing to cross from."""
    if status != code.OK and status != code.NO_PHASE:
        m.worst_share, m.phase_known = 0.0, 0
        return 0.0
    target = 1.0 if status == code.NO_PHASE else 0.0
    if m.phase_known == 0:
        m.worst_share = target
    m.worst_share += min(max(target - m.worst_share, -step), step)
    return 0.5 * (1.0 - math.cos(math.pi * m.worst_share))


@kernel
def cross_to_walls(
    bound_at: Any, scratch_at: Any, inputs: Any, t_s: float, xyz: FloatArray, status: int, dt_s: float
) -> int:
    """Mix what `fixtures_force` gave, at OK, or nothing, at NO_PHASE, with the other case.

    Not inlined: it runs where the phase is not known, or has just become known, alone. At NO_PHASE `sample`
    gets distance, gradient, rate by the pose and σ of the first wall within reach.

    Args:
        bound_at, scratch_at, inputs: of `servo_tick`.
        t_s, xyz: of `fixtures_force`; status: its answer.
        dt_s: since the last tick.
    Returns:
        the status; unless OK or NO_PHASE there is no force.
    """
    bound, scratch = borrowed_from(bound_at), borrowed_from(scratch_at)
    of, m, sample = bound.settings[0].fixtures, scratch.memory[0], scratch.sample[0]
    composed, other, forces = scratch.composed[0], scratch.other[0], scratch.forces
    if of.walls == 0:
        return status
    pose_phase = inputs.pose_and_phase
    if status == code.NO_PHASE:
        pose_status = status_at(pose_phase, t_s, xyz[0] + xyz[1] + xyz[2])
        status = status if pose_status == code.OK else pose_status
    share = _step_share(m, status, dt_s / bound.settings[0].limits.fade_s)
    if status != code.OK and status != code.NO_PHASE:
        return status
    pose = pose_at(pose_phase, t_s)
    place = in_model(pose, xyz)
    _widen(bound.packed, of, inputs.margin_mm)
    of_warp, tool = pose_phase.warped != 0.0, bound.settings[0].tool
    if tool.shaft_mm > 0.0:
        shaft_status = _find_shaft(tool, inputs, xyz, scratch.shaft)
        if shaft_status != code.OK:
            _forget_force(m, sample, composed)
            return shaft_status
    if status == code.NO_PHASE and share < 1.0:
        if of_warp:
            last = _warped_forces(
                bound, inputs, scratch.warps, t_s, place, m.last_phase, forces, scratch.fields
            )[0]
        else:
            last = _forces(bound, place, m.last_phase, None, forces, scratch.fields)
        if last[0] == code.OK and tool.shaft_mm > 0.0:
            last = _on_shaft(bound_at, scratch_at, inputs, t_s, place, m.last_phase, last)[0]
        if last[0] == code.OK:
            _turn_forces(pose, forces)
            _compose(bound, scratch, composed)
    if status == code.OK and share <= 0.0:
        return status
    begun = False
    for i in range(len(bound.packed)):
        forces[i, 0] = forces[i, 1] = forces[i, 2] = 0.0
        if of.forbidden[i] == 0.0:
            continue
        of_model = _coefficients(bound, i)
        variance, by_warp, met_mm = 0.0, 0.0, 0.0
        if of_warp:
            worst, variance, by_warp = _warped_wall(
                of_model, bound.packed[i], inputs, scratch.warps, t_s, place
            )
        else:
            worst = worst_phase_force(of_model, bound.packed[i], place, None)
        if tool.shaft_mm > 0.0 and _keeps_out(bound, i):
            worst, met_mm = _wall_on_shaft(bound, scratch, inputs, t_s, place, math.nan, i)
        if worst[0] == code.OUT_OF_VOLUME and of.far_outside[i] != 0:
            continue
        if worst[0] != code.OK:
            _forget_force(m, sample, composed)
            return worst[0]
        forces[i, 0], forces[i, 1], forces[i, 2] = worst[1]
        if status == code.NO_PHASE and not begun:
            begun = True
            gradient = _to_tracker(pose, worst[3])
            sample.distance_mm, sample.rate_mm_per_cycle = worst[2] + tool.radius_mm, 0.0
            _take_gradient(sample, scratch.shaft, met_mm, gradient)
            met = _met_place(scratch, xyz, met_mm)
            by_place, sigma = distance_rate_and_sigma(pose_phase, pose, NO_RATE, met, gradient, 0.0)
            sample.distance_rate_mm_s = by_place - by_warp
            sample.sigma_mm = math.sqrt(sigma * sigma + variance) if of_warp else sigma
    _turn_forces(pose, forces)
    _compose(bound, scratch, other)
    for k in range(3):
        composed.forbidden_n[k] += share * (other.forbidden_n[k] - composed.forbidden_n[k])
        composed.guidance_n[k] += share * (other.guidance_n[k] - composed.guidance_n[k])
    if status == code.NO_PHASE:
        composed.conflict = other.conflict
    return status


@kernel
def _forget_force(m: Any, sample: Any, composed: Any) -> None:
    """A wall could not be evaluated: no force, and nothing to cross from."""
    m.worst_share, m.phase_known, composed.conflict = 0.0, 0, 0
    sample.distance_mm = sample.rate_mm_per_cycle = math.nan
    sample.distance_rate_mm_s = sample.sigma_mm = math.nan
    for k in range(3):
        composed.forbidden_n[k] = composed.guidance_n[k] = 0.0
        sample.gradient[k] = math.nan
