"""Forces of all fixtures where the tip of a tool is, in the model's frame.

Fixtures on the heart's surface share one evaluation of it; paths and further structures have their own.
"""

import math
from typing import Any

from dvf_ig.core import FloatArray
from dvf_ig.kernels import status as code
from dvf_ig.kernels.compiled import inlined, kernel
from dvf_ig.kernels.dynamic import contracted_by_mm, force_at, forces_on_surface
from dvf_ig.kernels.fixture_field import BLEND, BLEND_PERIODIC, CONTRACTION, DEPTH, LAW, Output, no_output
from dvf_ig.kernels.path import path_force
from dvf_ig.kernels.place import Columns
from dvf_ig.kernels.vectors import Vector
from dvf_ig.kernels.warp import Slope, contraction_at, known_share, output_through, warp_at, warped_vector
from dvf_ig.kernels.worst_phase import worst_phase_force

from .borrowed import borrowed_block
from .parts import note_field, to_tracker


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
def widen(packed: FloatArray, fixtures: Any, inputs: Any, t_s: float) -> None:
    """Set the laws to those with the published margins, and the contraction to that at a time."""
    margin_mm, contraction = inputs.margin_mm, contraction_at(inputs.pose_and_phase, t_s)[0]
    for i in range(len(packed)):
        packed[i, CONTRACTION] = contraction
        margin = margin_mm[i]
        packed[i, LAW + 1] = fixtures.base_width[i] + fixtures.widen_width[i] * margin
        packed[i, DEPTH] = fixtures.base_depth_mm[i] + fixtures.widen_depth[i] * margin


@inlined
def turn_forces(pose: Columns, forces: FloatArray) -> None:
    """(k, 3) forces of the model's frame, in place, in the tracker's."""
    for i in range(len(forces)):
        forces[i, 0], forces[i, 1], forces[i, 2] = to_tracker(
            pose, (forces[i, 0], forces[i, 1], forces[i, 2])
        )


@inlined
def _structure(bound: Any, i: int) -> Any:
    """Coefficients (n, cx, cy, cz) of the structure of fixture `i`."""
    of = bound.settings[0].fixtures
    shape = of.structure_shape[i]
    return borrowed_block(bound.structures, of.structure_begin[i], (shape[0], shape[1], shape[2], shape[3]))


@inlined
def surface_coefficients(bound: Any, i: int) -> Any:
    """Coefficients of the surface of fixture `i`."""
    if bound.settings[0].fixtures.apart[i] != 0:
        return _structure(bound, i)
    return bound.periodic if int(bound.packed[i, BLEND]) == BLEND_PERIODIC else bound.linear


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
def structure_output(bound: Any, i: int, place: Vector, phi: float, slope: Slope) -> Output:
    """Output of a fixture on a further structure; OK and NaN where its wall is too far away to be felt."""
    output = force_at(_structure(bound, i), bound.packed[i], place, phi, slope)
    if output[0] == code.OUT_OF_VOLUME and bound.settings[0].fixtures.far_outside[i] != 0:
        return no_output(code.OK)
    return output


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
            note_field(fields, i, warped_vector(slope, of_heart[3]), of_heart[4])
            continue
        if of.path_points[i] != 0:
            output = _path_output(bound, i, place, phi, slope)
        else:
            output = structure_output(bound, i, place, phi, slope)
        if output[0] != code.OK:
            return output
        forces[i, 0], forces[i, 1], forces[i, 2] = output[1]
        note_field(fields, i, warped_vector(slope, output[3]), output[4])
        if not begun and math.isfinite(output[2]):
            first, begun = output, True
    return first


@inlined
def forces_on_tip(
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
def warped_forces_on_tip(
    bound: Any,
    inputs: Any,
    warps: Any,
    t_s: float,
    place: Vector,
    phi: float,
    forces: FloatArray,
    fields: FloatArray,
) -> tuple[Output, float, float]:
    """`forces_on_tip` through the warp, variance of the wall's place, −∂d/∂t by its motion and contraction's.

    The output's distance and gradient are those through the warp (`through_warp`).
    """
    at, slope, variance, moving = warp_at(warps, inputs.pose_and_phase, t_s, place)
    share = known_share(variance)
    if share == 0.0:
        return no_output(code.UNSEEN), variance, 0.0
    output = forces_on_tip(bound, at, phi, slope, forces, fields)
    for i in range(len(forces)):
        for k in range(3):
            forces[i, k] *= share
    output, by_warp = output_through(output, slope, share, moving)
    per_s, on_surface = contraction_at(inputs.pose_and_phase, t_s)[1], bound.settings[0].fixtures.first
    if per_s != 0.0 and on_surface < len(bound.packed):
        of_model, f = surface_coefficients(bound, on_surface), bound.packed[on_surface]
        by_warp -= per_s * contracted_by_mm(of_model, f, at, phi)
    return output, variance, by_warp


@kernel
def warped_wall_on_tip(
    of_model: Any, f: FloatArray, inputs: Any, warps: Any, t_s: float, place: Vector
) -> tuple[Output, float, float]:
    """`worst_phase_force` through the warp; results as of `warped_forces_on_tip`."""
    at, slope, variance, moving = warp_at(warps, inputs.pose_and_phase, t_s, place)
    share = known_share(variance)
    if share == 0.0:
        return no_output(code.UNSEEN), variance, 0.0
    output, by_warp = output_through(worst_phase_force(of_model, f, at, slope), slope, share, moving)
    return output, variance, by_warp
