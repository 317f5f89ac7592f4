"""The dynamic virtual fixture in one call (Ren 2008, eqs 1, 4–11): pose, phases, splines, law, blend, force.

A heart that contracts otherwise than the model takes, for the field of each phase, that at its rest and a
multiple of what differs from it (`contracted`).

Corrected eq. 10: F = (1−α) F(V_i) + α F(V_{i+1}); as printed, the weights are swapped and the force jumps at
every frame switch (docs/theory/fixtures.md).
"""

import math

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, IntArray

from . import status as code
from .compiled import inlined, kernel
from .fixture_field import (
    BLEND,
    BLEND_DISTANCE,
    BLEND_PERIODIC,
    CONTRACTION,
    DEPTH,
    PER_KNOT,
    POSE,
    POWERS,
    REST,
    TIMES,
    WITHOUT_RATE,
    Output,
    cells_of,
    contracted,
    field_of_phase,
    force_per_gradient,
    force_per_gradient_of_field,
    knot_coordinates,
    no_output,
    output_of,
    within_seen,
)
from .lanes import Float64x4, fma, pack, scale, unpack
from .phase import cubic_in_phase, phase_bracket
from .spline import Cell, cell_value, find_cell
from .vectors import Vector
from .warp import Slope, warped
from .worst_phase import field_at_phase, force_of_phase, wall_without_phase


@inlined
def _force_per_gradient_of_blend(f: FloatArray, field: Float64x4) -> float:
    """`force_per_gradient` on a blended field; d/|∇d| because a blend of distances is not a distance."""
    d, gx, gy, gz = unpack(field)
    norm = math.sqrt(gx * gx + gy * gy + gz * gz)
    return force_per_gradient(f, d / norm - f[DEPTH], norm) if norm > 0.0 else 0.0


@kernel
def at_rest(coefficients: NDArray[np.float32], f: FloatArray, cell: Cell) -> Float64x4:
    """Evaluate (distance, gradient) at rest, from which the heart contracts.

    Not inlined: few hearts need it.
    """
    return field_at_phase(coefficients, f, int(f[REST]), cell, len(coefficients))


@kernel
def _periodic_at(
    coefficients: NDArray[np.float32], f: FloatArray, q: Vector, phi: float, slope: Slope
) -> Output:
    """Evaluate a fixture cubic in phase: one law on the blended field of the periodic spline.

    Not inlined: it would take registers from its callers (docs/decisions/0006).
    """
    status, u, v, w = knot_coordinates(coefficients, f, q, phi)
    if status != code.OK:
        return no_output(status)
    cell = find_cell(u, v, w, cells_of(coefficients))
    count, per_knot = len(coefficients), f[PER_KNOT]
    first, second, alpha, width = phase_bracket(f, TIMES, count, phi)
    weights, slopes = cubic_in_phase(f, TIMES + count + POWERS * first, alpha)
    before = first - 1 if first > 0 else count - 1
    after = second + 1 if second + 1 < count else 0
    a = field_of_phase(coefficients, before, cell, per_knot)
    b = field_of_phase(coefficients, first, cell, per_knot)
    mixed = fma(scale(weights[0], a), weights[1], b)
    sloped = fma(scale(slopes[0], a), slopes[1], b)
    a = field_of_phase(coefficients, second, cell, per_knot)
    b = field_of_phase(coefficients, after, cell, per_knot)
    mixed = fma(fma(mixed, weights[2], a), weights[3], b)
    sloped = fma(fma(sloped, slopes[2], a), slopes[3], b)
    if f[CONTRACTION] != 1.0:
        mixed, sloped = contracted(f, at_rest(coefficients, f, cell), mixed), scale(f[CONTRACTION], sloped)
    turned = warped(slope, mixed)
    force = scale(_force_per_gradient_of_blend(f, turned), turned)
    return within_seen(f, count, q, phi, output_of(force, mixed, unpack(sloped)[0] / width))


@inlined
def _between(
    a: Float64x4, b: Float64x4, alpha: float, width: float
) -> tuple[Float64x4, Float64x4, Float64x4, float, float]:
    """Blend two fields; results as of `_two_fields`."""
    mixed = fma(scale(1.0 - alpha, a), alpha, b)
    return a, b, mixed, alpha, (unpack(b)[0] - unpack(a)[0]) / width


@inlined
def _two_fields(
    coefficients: NDArray[np.float32], f: FloatArray, knot: Vector, phi: float
) -> tuple[Float64x4, Float64x4, Float64x4, float, float]:
    """Evaluate the fields of the phases around `phi`, their blend, the second's weight, the distance rate."""
    if f[CONTRACTION] != 1.0:
        return _two_contracted_fields(coefficients, f, knot, phi)
    cell = find_cell(knot[0], knot[1], knot[2], cells_of(coefficients))
    first, second, alpha, width = phase_bracket(f, TIMES, len(coefficients), phi)
    a = field_of_phase(coefficients, first, cell, f[PER_KNOT])
    b = field_of_phase(coefficients, second, cell, f[PER_KNOT])
    return _between(a, b, alpha, width)


@kernel
def _two_contracted_fields(
    coefficients: NDArray[np.float32], f: FloatArray, knot: Vector, phi: float
) -> tuple[Float64x4, Float64x4, Float64x4, float, float]:
    """Evaluate `_two_fields` of a heart that contracts otherwise. Not inlined: few do."""
    cell = find_cell(knot[0], knot[1], knot[2], cells_of(coefficients))
    first, second, alpha, width = phase_bracket(f, TIMES, len(coefficients), phi)
    rest = at_rest(coefficients, f, cell)
    a = contracted(f, rest, field_of_phase(coefficients, first, cell, f[PER_KNOT]))
    b = contracted(f, rest, field_of_phase(coefficients, second, cell, f[PER_KNOT]))
    return _between(a, b, alpha, width)


@inlined
def _blended_force(
    f: FloatArray, a: Float64x4, b: Float64x4, mixed: Float64x4, alpha: float, slope: Slope
) -> Float64x4:
    """Compute (0, force) of a fixture that is linear in phase."""
    if int(f[BLEND]) == BLEND_DISTANCE:
        turned = warped(slope, mixed)
        return scale(_force_per_gradient_of_blend(f, turned), turned)
    if slope is not None:
        return fma(scale(1.0 - alpha, force_of_phase(f, a, slope)), alpha, force_of_phase(f, b, slope))
    return fma(
        scale((1.0 - alpha) * force_per_gradient_of_field(f, a), a),
        alpha * force_per_gradient_of_field(f, b),
        b,
    )


@inlined
def field_at(
    coefficients: NDArray[np.float32], f: FloatArray, q: Vector, phi: float
) -> tuple[int, float, Vector, float]:
    """Evaluate status, distance, gradient and distance rate at one point, linear in phase."""
    status, u, v, w = knot_coordinates(coefficients, f, q, phi)
    if status != code.OK:
        nothing = no_output(status)
        return status, nothing[2], nothing[3], nothing[4]
    _, _, mixed, _, rate = _two_fields(coefficients, f, (u, v, w), phi)
    d, gx, gy, gz = unpack(mixed)
    return code.OK, d, (gx, gy, gz), rate


@kernel
def distance_at(coefficients: NDArray[np.float32], f: FloatArray, q: Vector, phi: float) -> float:
    """Evaluate the distance alone at one point, by the fixture's blend; −∞ outside the box, also of NaN.

    Of a heart that contracts as the model does.
    """
    status, u, v, w = knot_coordinates(coefficients, f, q, phi)
    if status != code.OK:
        return -math.inf
    cell, count = find_cell(u, v, w, cells_of(coefficients)), len(coefficients)
    first, second, alpha, _ = phase_bracket(f, TIMES, count, phi)
    if int(f[BLEND]) != BLEND_PERIODIC:
        return (1.0 - alpha) * cell_value(coefficients, np.uintp(first), cell) + alpha * cell_value(
            coefficients, np.uintp(second), cell
        )
    weights, _ = cubic_in_phase(f, TIMES + count + POWERS * first, alpha)
    before = first - 1 if first > 0 else count - 1
    after = second + 1 if second + 1 < count else 0
    return (
        weights[0] * cell_value(coefficients, np.uintp(before), cell)
        + weights[1] * cell_value(coefficients, np.uintp(first), cell)
        + weights[2] * cell_value(coefficients, np.uintp(second), cell)
        + weights[3] * cell_value(coefficients, np.uintp(after), cell)
    )


@kernel
def contracted_by_mm(coefficients: NDArray[np.float32], f: FloatArray, q: Vector, phi: float) -> float:
    """Compute how far d lies from that at rest, in the model: d'(q, φ) changes by it with the contraction.

    0 outside the box.
    """
    status, u, v, w = knot_coordinates(coefficients, f, q, phi)
    if status != code.OK:
        return 0.0
    resting = at_rest(coefficients, f, find_cell(u, v, w, cells_of(coefficients)))
    by_mm: float = distance_at(coefficients, f, q, phi) - unpack(resting)[0]
    return by_mm


@inlined
def force_at(coefficients: NDArray[np.float32], f: FloatArray, q: Vector, phi: float, slope: Slope) -> Output:
    """Compute the force at one point of the model's frame; linear in phase, unless the blend is periodic.

    Args:
        q: through the warp, if the heart has changed its shape; slope: of the warp there, or None.
    Returns:
        the force is along ∇d', through the warp; the gradient is ∇d at q.
    """
    if int(f[BLEND]) == BLEND_PERIODIC:
        return _periodic_at(coefficients, f, q, phi, slope)
    status, u, v, w = knot_coordinates(coefficients, f, q, phi)
    if status != code.OK:
        return no_output(status)
    a, b, mixed, alpha, rate = _two_fields(coefficients, f, (u, v, w), phi)
    output = output_of(_blended_force(f, a, b, mixed, alpha, slope), mixed, rate)
    return within_seen(f, len(coefficients), q, phi, output)


@inlined
def forces_on_surface(
    linear: NDArray[np.float32],
    periodic: NDArray[np.float32],
    packed: FloatArray,
    apart: IntArray,
    first_linear: int,
    q: Vector,
    phi: float,
    slope: Slope,
    forces: FloatArray,
) -> Output:
    """Compute forces of several fixtures on one surface; those linear in phase share the spline's evaluation.

    Args:
        linear, periodic: (n, cx, cy, cz) coefficients of the two kinds of blend; (0, …) of one not used.
        packed: (k, p) fixtures; their poses are not used.
        apart: (k,) 1 for a fixture that is not on this surface, which has no force here.
        first_linear: the first fixture on this surface that is linear in phase, if there is one.
        q, slope: as of `force_at`.
        phi: model phase.
        forces: (k, 3) N, model frame; complete only if the status is OK.
    Returns:
        output of the first fixture on this surface, NaN without one; the status is the first that is not OK.
    """
    nothing = pack(0.0, 0.0, 0.0, 0.0)
    a, b, mixed, alpha, rate = nothing, nothing, nothing, 0.0, 0.0
    if len(linear) > 0:
        status, u, v, w = knot_coordinates(linear, packed[first_linear], q, phi)
        if status != code.OK:
            return no_output(status)
        a, b, mixed, alpha, rate = _two_fields(linear, packed[first_linear], (u, v, w), phi)
    first, begun = no_output(code.OK), False
    for i in range(len(packed)):
        if apart[i] != 0:
            continue
        f = packed[i]
        if int(f[BLEND]) == BLEND_PERIODIC:
            result = _periodic_at(periodic, f, q, phi, slope)
        else:
            result = output_of(_blended_force(f, a, b, mixed, alpha, slope), mixed, rate)
            result = within_seen(f, len(linear), q, phi, result)
        if result[0] != code.OK:
            return no_output(result[0])
        forces[i, 0], forces[i, 1], forces[i, 2] = result[1]
        if not begun:
            first, begun = result, True
    return first


@inlined
def transformed(f: FloatArray, x: float, y: float, z: float) -> Vector:
    return (
        f[POSE] * x + f[POSE + 1] * y + f[POSE + 2] * z + f[POSE + 3],
        f[POSE + 4] * x + f[POSE + 5] * y + f[POSE + 6] * z + f[POSE + 7],
        f[POSE + 8] * x + f[POSE + 9] * y + f[POSE + 10] * z + f[POSE + 11],
    )


@inlined
def rotated_back(f: FloatArray, v: Vector) -> Vector:
    """Rotate a free vector from the model's frame to the query frame: Rᵀ v."""
    return (
        f[POSE] * v[0] + f[POSE + 4] * v[1] + f[POSE + 8] * v[2],
        f[POSE + 1] * v[0] + f[POSE + 5] * v[1] + f[POSE + 9] * v[2],
        f[POSE + 2] * v[0] + f[POSE + 6] * v[1] + f[POSE + 10] * v[2],
    )


@kernel
def force_tick(
    coefficients: NDArray[np.float32],
    packed: FloatArray,
    xyz_mm: FloatArray,
    phi: float,
    input_status: int,
    out: FloatArray,
) -> int:
    """Compute the force at one point; the call of a servo loop.

    Args:
        coefficients: (n, cx, cy, cz) mm; of the phases, or of the periodic spline through them.
        packed: the fixture without its coefficients (`packed_fixture`).
        xyz_mm: (3,) point in the query frame.
        phi: model phase.
        input_status: status of the inputs; anything but OK is returned with zero force, except that
            NO_PHASE gives a wall the force of its worst phase (`dvf_ig.kernels.worst_phase`).
        out: (7,) force in N, distance in mm, gradient of distance, vectors in the query frame; (8,) for
            the distance rate as well, in mm a cycle.
    Returns:
        status code; unless OK, or NO_PHASE of a wall, the force is zero and the rest NaN.
    """
    status, force, d, gradient, rate = no_output(input_status)
    if status == code.OK:
        q = transformed(packed, xyz_mm[0], xyz_mm[1], xyz_mm[2])
        status, force, d, gradient, rate = force_at(coefficients, packed, q, phi, None)
    elif status == code.NO_PHASE:
        q = transformed(packed, xyz_mm[0], xyz_mm[1], xyz_mm[2])
        status, force, d, gradient, rate = wall_without_phase(coefficients, packed, q, None)
    out[0], out[1], out[2] = rotated_back(packed, force)
    out[3] = d
    out[4], out[5], out[6] = rotated_back(packed, gradient)
    if len(out) > WITHOUT_RATE:
        out[WITHOUT_RATE] = rate
    return status


@kernel
def force_batch(
    coefficients: NDArray[np.float32],
    packed: FloatArray,
    xyz_mm: FloatArray,
    phi: FloatArray,
    force_n: FloatArray,
    distance_mm: FloatArray,
    gradient: FloatArray,
    rate_mm_per_cycle: FloatArray,
    status: IntArray,
) -> None:
    """Compute `force_tick` for (k, 3) points and (k,) phases; `status` holds `input_status` on entry."""
    for n in range(len(xyz_mm)):
        code_n, force, d, g, rate = no_output(status[n])
        if code_n == code.OK:
            q = transformed(packed, xyz_mm[n, 0], xyz_mm[n, 1], xyz_mm[n, 2])
            code_n, force, d, g, rate = force_at(coefficients, packed, q, phi[n], None)
        status[n] = code_n
        force_n[n, 0], force_n[n, 1], force_n[n, 2] = rotated_back(packed, force)
        distance_mm[n] = d
        gradient[n, 0], gradient[n, 1], gradient[n, 2] = rotated_back(packed, g)
        rate_mm_per_cycle[n] = rate
    _walls_without_phase(
        coefficients, packed, xyz_mm, force_n, distance_mm, gradient, rate_mm_per_cycle, status
    )


@kernel
def _walls_without_phase(
    coefficients: NDArray[np.float32],
    packed: FloatArray,
    xyz_mm: FloatArray,
    force_n: FloatArray,
    distance_mm: FloatArray,
    gradient: FloatArray,
    rate_mm_per_cycle: FloatArray,
    status: IntArray,
) -> None:
    """Fill the entries of `force_batch` at NO_PHASE; a call in the main loop would slow it by 5 %."""
    for n in range(len(xyz_mm)):
        if status[n] == code.NO_PHASE:
            q = transformed(packed, xyz_mm[n, 0], xyz_mm[n, 1], xyz_mm[n, 2])
            status[n], force, d, g, rate = wall_without_phase(coefficients, packed, q, None)
            force_n[n, 0], force_n[n, 1], force_n[n, 2] = rotated_back(packed, force)
            distance_mm[n] = d
            gradient[n, 0], gradient[n, 1], gradient[n, 2] = rotated_back(packed, g)
            rate_mm_per_cycle[n] = rate
