"""All fixtures of a servo at one place and time, in the tracker's frame."""

import math
from typing import Any

from dvf_ig.core import FloatArray
from dvf_ig.kernels import status as code
from dvf_ig.kernels.compiled import inlined
from dvf_ig.kernels.composition import compose_forces
from dvf_ig.kernels.place import phase_at, pose_at, status_at
from dvf_ig.kernels.pose_and_phase import distance_rate_and_sigma

from .borrowed import borrowed_from
from .parts import note_parts, to_tracker
from .shaft import find_shaft, met_place, on_shaft, take_gradient
from .tip import forces_on_tip, in_model, turn_forces, warped_forces_on_tip, widen


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
def compose(bound: Any, scratch: Any, out: Any) -> None:
    of, cap_n = bound.settings[0].fixtures, bound.settings[0].cap_n
    compose_forces(scratch.forces, of.cap_n, of.forbidden, cap_n, scratch.work, scratch.order, out)


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
    widen(bound.packed, bound.settings[0].fixtures, inputs, t_s)
    place, variance, by_warp = in_model(pose, xyz), 0.0, 0.0
    if inputs.pose_and_phase.warped == 0.0:
        output = forces_on_tip(bound, place, phase[0], None, scratch.forces, scratch.fields)
    else:
        output, variance, by_warp = warped_forces_on_tip(
            bound, inputs, scratch.warps, t_s, place, phase[0], scratch.forces, scratch.fields
        )
    tool, met_mm = bound.settings[0].tool, 0.0
    if output[0] == code.OK and tool.shaft_mm > 0.0:
        status = find_shaft(tool, inputs, xyz, scratch.shaft)
        if status != code.OK:
            return status
        output, met_mm = on_shaft(bound_at, scratch_at, inputs, t_s, place, phase[0], output)
    if output[0] != code.OK:
        return output[0]
    turn_forces(pose, scratch.forces)
    gradient = to_tracker(pose, output[3])
    sample.distance_mm = output[2] + tool.radius_mm
    sample.rate_mm_per_cycle = output[4] if bound.settings[0].fixtures.path_points[0] == 0 else math.nan
    take_gradient(sample, scratch.shaft, met_mm, gradient)
    compose(bound, scratch, composed)
    if bound.settings[0].fixtures.others != 0:
        sample.parts = note_parts(bound, scratch, pose, phase, xyz)
    met = met_place(scratch, xyz, met_mm)
    by_place, sigma = distance_rate_and_sigma(inputs.pose_and_phase, pose, phase, met, gradient, output[4])
    sample.distance_rate_mm_s = by_place
    sample.sigma_mm = sigma
    if inputs.pose_and_phase.warped != 0.0:
        sample.distance_rate_mm_s = by_place - by_warp
        sample.sigma_mm = math.sqrt(sigma * sigma + variance)
    return code.OK
