"""Walls while the phase of the heart is lost.

When the phase is lost, guidance fades and walls become those of the worst phase; for 250 ms the composed
force is (1 − c) of the fixtures at the last known phase plus c of the walls at their worst phase, c a raised
cosine of the share that has passed; so it is when the phase is known again. Both are evaluated where the tool
is now. A wall at its worst phase pushes no less than at any other, so no wall gives way.
"""

import math
from typing import Any

from dvf_ig.core import FloatArray
from dvf_ig.kernels import status as code
from dvf_ig.kernels.compiled import kernel
from dvf_ig.kernels.place import Columns, pose_at, status_at
from dvf_ig.kernels.pose_and_phase import distance_rate_and_sigma
from dvf_ig.kernels.vectors import Vector
from dvf_ig.kernels.worst_phase import worst_phase_force

from .borrowed import borrowed_from
from .fixtures import compose
from .parts import to_tracker
from .shaft import find_shaft, keeps_out, met_place, on_shaft, take_gradient, wall_of_shaft
from .tip import (
    forces_on_tip,
    in_model,
    surface_coefficients,
    turn_forces,
    warped_forces_on_tip,
    warped_wall_on_tip,
    widen,
)

NO_RATE = (0.0, 0.0, 0.0)
"""Phase, its rate and its standard deviation where a wall at its worst phase does not depend on them."""


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
def _forget_force(m: Any, sample: Any, composed: Any) -> None:
    """A wall could not be evaluated: no force, and nothing to cross from."""
    m.worst_share, m.phase_known, composed.conflict = 0.0, 0, 0
    sample.distance_mm = sample.rate_mm_per_cycle = math.nan
    sample.distance_rate_mm_s = sample.sigma_mm = math.nan
    for k in range(3):
        composed.forbidden_n[k] = composed.guidance_n[k] = 0.0
        sample.gradient[k] = math.nan


@kernel
def _compose_last(
    bound_at: Any, scratch_at: Any, inputs: Any, t_s: float, place: Vector, pose: Columns
) -> None:
    """Compose the fixtures' forces at the last known phase, if they have one there."""
    bound, scratch = borrowed_from(bound_at), borrowed_from(scratch_at)
    phi, on_whole_tool = scratch.memory[0].last_phase, bound.settings[0].tool.shaft_mm > 0.0
    if inputs.pose_and_phase.warped != 0.0:
        last = warped_forces_on_tip(
            bound, inputs, scratch.warps, t_s, place, phi, scratch.forces, scratch.fields
        )[0]
    else:
        last = forces_on_tip(bound, place, phi, None, scratch.forces, scratch.fields)
    if last[0] == code.OK and on_whole_tool:
        last = on_shaft(bound_at, scratch_at, inputs, t_s, place, phi, last)[0]
    if last[0] == code.OK:
        turn_forces(pose, scratch.forces)
        compose(bound, scratch, scratch.composed[0])


@kernel
def _compose_walls(
    bound_at: Any,
    scratch_at: Any,
    inputs: Any,
    t_s: float,
    xyz: FloatArray,
    place: Vector,
    pose: Columns,
    lost: bool,
) -> int:
    """Compose the walls at their worst phase into `other`; the first within reach into `sample` if `lost`."""
    bound, scratch = borrowed_from(bound_at), borrowed_from(scratch_at)
    of, tool, forces = bound.settings[0].fixtures, bound.settings[0].tool, scratch.forces
    of_warp = inputs.pose_and_phase.warped != 0.0
    for i in range(len(bound.packed)):
        forces[i, 0] = forces[i, 1] = forces[i, 2] = 0.0
        if of.forbidden[i] == 0.0:
            continue
        of_model = surface_coefficients(bound, i)
        variance, by_warp, met_mm = 0.0, 0.0, 0.0
        if of_warp:
            worst, variance, by_warp = warped_wall_on_tip(
                of_model, bound.packed[i], inputs, scratch.warps, t_s, place
            )
        else:
            worst = worst_phase_force(of_model, bound.packed[i], place, None)
        if tool.shaft_mm > 0.0 and keeps_out(bound, i):
            worst, met_mm = wall_of_shaft(bound, scratch, inputs, t_s, place, math.nan, i)
        if worst[0] == code.OUT_OF_VOLUME and of.far_outside[i] != 0:
            continue
        if worst[0] != code.OK:
            return worst[0]
        forces[i, 0], forces[i, 1], forces[i, 2] = worst[1]
        if lost:
            lost, sample = False, scratch.sample[0]
            gradient = to_tracker(pose, worst[3])
            sample.distance_mm, sample.rate_mm_per_cycle = worst[2] + tool.radius_mm, 0.0
            take_gradient(sample, scratch.shaft, met_mm, gradient)
            by_place, sigma = distance_rate_and_sigma(
                inputs.pose_and_phase, pose, NO_RATE, met_place(scratch, xyz, met_mm), gradient, 0.0
            )
            sample.distance_rate_mm_s = by_place - by_warp
            sample.sigma_mm = math.sqrt(sigma * sigma + variance) if of_warp else sigma
    turn_forces(pose, forces)
    compose(bound, scratch, scratch.other[0])
    return code.OK


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
    m, composed, other = scratch.memory[0], scratch.composed[0], scratch.other[0]
    if bound.settings[0].fixtures.walls == 0:
        return status
    pose_phase, tool = inputs.pose_and_phase, bound.settings[0].tool
    if status == code.NO_PHASE:
        pose_status = status_at(pose_phase, t_s, xyz[0] + xyz[1] + xyz[2])
        status = status if pose_status == code.OK else pose_status
    share = _step_share(m, status, dt_s / bound.settings[0].limits.fade_s)
    if status != code.OK and status != code.NO_PHASE:
        return status
    pose = pose_at(pose_phase, t_s)
    place = in_model(pose, xyz)
    widen(bound.packed, bound.settings[0].fixtures, inputs, t_s)
    if tool.shaft_mm > 0.0:
        shaft_status = find_shaft(tool, inputs, xyz, scratch.shaft)
        if shaft_status != code.OK:
            _forget_force(m, scratch.sample[0], composed)
            return shaft_status
    lost = status == code.NO_PHASE
    if lost and share < 1.0:
        _compose_last(bound_at, scratch_at, inputs, t_s, place, pose)
    if not lost and share <= 0.0:
        return status
    of_walls = _compose_walls(bound_at, scratch_at, inputs, t_s, xyz, place, pose, lost)
    if of_walls != code.OK:
        _forget_force(m, scratch.sample[0], composed)
        return of_walls
    for k in range(3):
        composed.forbidden_n[k] += share * (other.forbidden_n[k] - composed.forbidden_n[k])
        composed.guidance_n[k] += share * (other.guidance_n[k] - composed.guidance_n[k])
    if lost:
        composed.conflict = other.conflict
    return status
