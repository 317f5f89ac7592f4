"""A forbidden region where the cardiac phase is not known: the surface of the worst phase, made smooth.

With d_i the distance in each of the model's N phases, a wall that keeps out of an organ takes

    d = τ log Σ exp(d_i/τ),    ∇d = Σ w_i ∇d_i,    w_i = exp(d_i/τ) / Σ exp(d_j/τ)

which is max_i d_i (docs/theory/safety.md), or up to τ log N more if several phases reach equally far: never
less protection, and a gradient without steps, so that the force never jumps from one phase's direction to
another's. A confinement takes −τ log Σ exp(−d_i/τ): the narrowest chamber. The readable form is
`tests/oracles/readable_walls.py`.

Source: the smooth maximum, Boyd and Vandenberghe 2004, section 3.1.5.
"""

import math

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray

from . import status as code
from .compiled import inlined, kernel
from .fixture_field import (
    BLEND,
    BLEND_PERIODIC,
    DEPTH,
    LAW,
    PER_KNOT,
    POWERS,
    REST,
    SEEN,
    TIMES,
    Output,
    cells_of,
    contracted,
    field_of_phase,
    force_per_gradient,
    force_per_gradient_of_field,
    knot_coordinates,
    no_output,
    output_of,
    seen_share,
)
from .lanes import Float64x4, fma, pack, scale, unpack
from .laws import SIGMOID
from .spline import Cell, find_cell
from .vectors import Vector
from .warp import Slope, through_warp

SMOOTHING_MM = 0.25
"""τ, the pitch between frames in Ren 2008: 20 phases that coincide widen a wall by 0.75 mm."""


@inlined
def is_wall(f: FloatArray) -> bool:
    """Return whether a packed fixture is a forbidden region or a confinement."""
    return int(f[LAW]) == SIGMOID


@inlined
def field_at_phase(
    coefficients: NDArray[np.float32], f: FloatArray, phase: int, cell: Cell, count: int
) -> Float64x4:
    """Evaluate (distance, gradient) at a phase's own time; a periodic spline has three parts there."""
    if int(f[BLEND]) != BLEND_PERIODIC:
        return field_of_phase(coefficients, phase, cell, f[PER_KNOT])
    weights = TIMES + count + POWERS * phase
    before = phase - 1 if phase > 0 else count - 1
    after = phase + 1 if phase + 1 < count else 0
    sum_ = scale(f[weights], field_of_phase(coefficients, before, cell, f[PER_KNOT]))
    sum_ = fma(sum_, f[weights + 1], field_of_phase(coefficients, phase, cell, f[PER_KNOT]))
    return fma(sum_, f[weights + 2], field_of_phase(coefficients, after, cell, f[PER_KNOT]))


@inlined
def force_of_phase(f: FloatArray, field: Float64x4, slope: Slope) -> Float64x4:
    """Compute (0, force) of one phase's field; through a warp the law takes the stretched distance."""
    if slope is None:
        return scale(force_per_gradient_of_field(f, field), field)
    d, gx, gy, gz = unpack(field)
    d, (x, y, z) = through_warp(slope, d, (gx, gy, gz))
    norm = math.sqrt(x * x + y * y + z * z)
    return scale(force_per_gradient(f, d - f[DEPTH], norm), pack(0.0, x, y, z))


@kernel
def worst_phase_force(coefficients: NDArray[np.float32], f: FloatArray, q: Vector, slope: Slope) -> Output:
    """Compute force, distance and gradient of a wall at its worst phase; its rate by the phase is zero.

    Not inlined: it is called only while the phase is not known, and must cost nothing otherwise.

    Args:
        coefficients, f: those of a wall, as in `dvf_ig.kernels.dynamic.force_tick`.
        q, slope: as of `dvf_ig.kernels.dynamic.force_at`.
    Returns:
        status OK, OUT_OF_VOLUME or FAULT; force only at OK; gradient as of `force_at`.
    """
    status, u, v, w = knot_coordinates(coefficients, f, q, 0.0)
    if status != code.OK:
        return no_output(status)
    cell, count = find_cell(u, v, w, cells_of(coefficients)), len(coefficients)
    outward = 1.0 if f[LAW + 1] > 0.0 else -1.0
    at_rest = field_at_phase(coefficients, f, int(f[REST]), cell, count)
    most, total, mixed = -math.inf, 0.0, pack(0.0, 0.0, 0.0, 0.0)
    for phase in range(count):
        field = contracted(f, at_rest, field_at_phase(coefficients, f, phase, cell, count))
        reach = outward * unpack(field)[0]
        if reach > most:
            shrunk = math.exp((most - reach) / SMOOTHING_MM)
            mixed, total, most = fma(field, shrunk, mixed), 1.0 + shrunk * total, reach
        else:
            weight = math.exp((reach - most) / SMOOTHING_MM)
            mixed, total = fma(mixed, weight, field), total + weight
    _, gx, gy, gz = unpack(scale(1.0 / total, mixed))
    field = pack(outward * (most + SMOOTHING_MM * math.log(total)), gx, gy, gz)
    output = output_of(force_of_phase(f, field, slope), field, 0.0)
    if f[SEEN] == 0.0 or output[0] != code.OK:
        return output
    share = _seen_share(coefficients, f, q, cell, outward * most)
    if share == 0.0:
        return no_output(code.UNSEEN)
    force = output[1]
    return code.OK, (share * force[0], share * force[1], share * force[2]), output[2], output[3], 0.0


@kernel
def _seen_share(
    coefficients: NDArray[np.float32], f: FloatArray, q: Vector, cell: Cell, worst_mm: float
) -> float:
    """Compute the share of the force that remains, over all phases with the weights of the wall."""
    count, total, seen = len(coefficients), 0.0, 0.0
    at_rest = field_at_phase(coefficients, f, int(f[REST]), cell, count)
    for phase in range(count):
        field = contracted(f, at_rest, field_at_phase(coefficients, f, phase, cell, count))
        d, gx, gy, gz = unpack(field)
        weight = math.exp(-abs(worst_mm - d) / SMOOTHING_MM)
        total += weight
        seen += weight * seen_share(f, count, q, f[TIMES + phase], d, (gx, gy, gz))
    return seen / total


@kernel
def wall_without_phase(coefficients: NDArray[np.float32], f: FloatArray, q: Vector, slope: Slope) -> Output:
    """Compute `worst_phase_force` with NO_PHASE instead of OK; no force if the fixture is not a wall."""
    if not is_wall(f):
        return no_output(code.NO_PHASE)
    status, force, d, gradient, rate = worst_phase_force(coefficients, f, q, slope)
    return code.NO_PHASE if status == code.OK else status, force, d, gradient, rate
