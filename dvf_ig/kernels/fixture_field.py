"""A fixture packed in one array, and the field of one of its phases at a point."""

import math

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import RAMP_MM, FloatArray, SeenPart, phase_at_rest

from . import status as code
from .compiled import inlined, kernel
from .lanes import Float64x4, fma, multiply, pack, scale, unpack
from .laws import LARGEST_FORCE_N, direction_certainty, signed_potential
from .phase import phase_bracket
from .spline import Cell, cell_value_gradient, inside_box
from .vectors import Vector

BLEND_FORCE = 0
BLEND_DISTANCE = 1
BLEND_PERIODIC = 2
BLEND_PATH = 3
"""Index of a fixture on a path (`dvf_ig.kernels.path`); its origin and phases are those of the model."""

# Offsets in a packed fixture.
ORIGIN = 0
PER_KNOT = 3
BLEND = 4
LAW = 5
DEPTH = 9
POSE = 10
SEEN = 22
"""Number of slabs of the seen part, 0 if all is known; normal of the slices and width of the ramp follow."""
CONTRACTION, REST = 27, 28
"""How many times as far as in the model the heart contracts, and the index of its phase at rest."""
TIMES = 29
POWERS = 16
"""Count of numbers for each phase that follow the phase times with the periodic blend; bounds of the seen
slabs, phase after phase, come last."""

WITHOUT_RATE = 7
"""Count of numbers in the output of a tick: force 3, distance, gradient 3; the distance rate may follow."""

Output = tuple[int, Vector, float, Vector, float]
"""Status, force (N), distance (mm), gradient, distance rate (mm a cycle)."""


def packed_fixture(
    origin_mm: FloatArray,
    knot_mm: float,
    fractions: FloatArray,
    powers: FloatArray,
    law: FloatArray,
    blend: int,
    seen: SeenPart | None,
    model_from_query: FloatArray,
) -> FloatArray:
    """Pack all but the coefficients in one array: each array argument lengthens a call from Python.

    The heart contracts as in the model until a kernel says otherwise.

    Args:
        origin_mm: (3,); knot_mm: knot pitch.
        fractions: (n,) phase times as fractions of the cycle.
        powers: (n, 4, 4) phase weights of BLEND_PERIODIC (`cubic_in_phase`); (0, 4, 4) otherwise.
        law: (5,) kind, scale, exponent, cap in N, guarded depth in mm (dvf_ig.guidance laws).
        blend: BLEND_FORCE, BLEND_DISTANCE or BLEND_PERIODIC.
        seen: the part of the surface outside which there is no force; None: all of it is known.
        model_from_query: (3, 4) rigid map of query points into the model's frame.
    """
    slabs = np.zeros((0, 0, 2)) if seen is None else seen.bounds_mm
    normal = np.zeros(3) if seen is None else seen.normal
    head = [
        origin_mm,
        [1.0 / knot_mm, float(blend)],
        law,
        model_from_query.ravel(),
        [slabs.shape[1]],
        normal,
        [RAMP_MM],
        [1.0, phase_at_rest(fractions)],
    ]
    return np.concatenate([*head, fractions, powers.ravel(), slabs.ravel()])


@inlined
def no_output(status: int) -> Output:
    """Return zero force, everything else NaN."""
    undefined = (math.nan, math.nan, math.nan)
    return status, (0.0, 0.0, 0.0), math.nan, undefined, math.nan


@inlined
def force_per_gradient(f: FloatArray, s_mm: float, norm: float) -> float:
    """Compute the force per unit of gradient: −cap·f(s)·certainty/|∇d|; zero where the direction is lost.

    Whatever the packed cap is, no force is longer than LARGEST_FORCE_N.
    """
    certainty = direction_certainty(norm)
    if certainty == 0.0:
        return 0.0
    potential = signed_potential(int(f[LAW]), f[LAW + 1], f[LAW + 2], s_mm)
    cap_n = min(max(f[LAW + 3], -LARGEST_FORCE_N), LARGEST_FORCE_N)
    ratio: float = -cap_n * potential * certainty / norm
    return ratio


@inlined
def force_per_gradient_of_field(f: FloatArray, field: Float64x4) -> float:
    """Compute `force_per_gradient` at a distance and gradient of one phase."""
    d, gx, gy, gz = unpack(field)
    return force_per_gradient(f, d - f[DEPTH], math.sqrt(gx * gx + gy * gy + gz * gz))


@inlined
def field_of_phase(coefficients: NDArray[np.float32], phase: int, cell: Cell, per_knot: float) -> Float64x4:
    """Evaluate (distance, gradient) of one phase, gradient per mm."""
    return multiply(
        pack(1.0, per_knot, per_knot, per_knot), cell_value_gradient(coefficients, np.uintp(phase), cell)
    )


@inlined
def contracted(f: FloatArray, at_rest: Float64x4, field: Float64x4) -> Float64x4:
    """Compute d₀ + g (d − d₀), and its gradient, of a heart that contracts g times as far as the model's."""
    return fma(scale(1.0 - f[CONTRACTION], at_rest), f[CONTRACTION], field)


@inlined
def cells_of(coefficients: NDArray[np.float32]) -> tuple[int, int, int]:
    """Count the spline's cells along each axis."""
    return coefficients.shape[1] - 3, coefficients.shape[2] - 3, coefficients.shape[3] - 3


@inlined
def knot_coordinates(
    coefficients: NDArray[np.float32], f: FloatArray, q: Vector, phi: float
) -> tuple[int, float, float, float]:
    """Convert a point to knot coordinates, with its status."""
    u = (q[0] - f[ORIGIN]) * f[PER_KNOT]
    v = (q[1] - f[ORIGIN + 1]) * f[PER_KNOT]
    w = (q[2] - f[ORIGIN + 2]) * f[PER_KNOT]
    if not math.isfinite(u + v + w + phi):
        return code.FAULT, u, v, w
    return code.OK if inside_box(u, v, w, cells_of(coefficients)) else code.OUT_OF_VOLUME, u, v, w


@inlined
def output_of(force: Float64x4, field: Float64x4, rate: float) -> Output:
    """Assemble the output from the rows (0, force) and (distance, gradient), and the distance rate."""
    _, fx, fy, fz = unpack(force)
    d, gx, gy, gz = unpack(field)
    if not math.isfinite(fx + fy + fz):
        return no_output(code.FAULT)
    return code.OK, (fx, fy, fz), d, (gx, gy, gz), rate


@inlined
def within_seen(f: FloatArray, count: int, q: Vector, phi: float, output: Output) -> Output:
    """Take the force away where the nearest point of the surface was not seen."""
    if f[SEEN] == 0.0 or output[0] != code.OK:
        return output
    return _limited(f, count, q, phi, output)


@kernel
def seen_share(f: FloatArray, count: int, q: Vector, phi: float, distance: float, gradient: Vector) -> float:
    """Compute the share of the force that remains (`dvf_ig.core.SeenPart.share`); for `count` phases."""
    first, second, alpha, _ = phase_bracket(f, TIMES, count, phi)
    gx, gy, gz = gradient
    square = gx * gx + gy * gy + gz * gz
    step = distance / square if square > 0.04 else 0.0
    height = (
        f[SEEN + 1] * (q[0] - step * gx) + f[SEEN + 2] * (q[1] - step * gy) + f[SEEN + 3] * (q[2] - step * gz)
    )
    start = TIMES + count
    if int(f[BLEND]) == BLEND_PERIODIC:
        start += POWERS * count
    slabs = int(f[SEEN])
    within = -math.inf
    for j in range(slabs):
        a, b = start + 2 * (slabs * first + j), start + 2 * (slabs * second + j)
        low = (1.0 - alpha) * f[a] + alpha * f[b]
        high = (1.0 - alpha) * f[a + 1] + alpha * f[b + 1]
        within = max(within, min(height - low, high - height))
    part = min(max(within / f[SEEN + 4], 0.0), 1.0)
    return float(part * part * (3.0 - 2.0 * part))


@kernel
def _limited(f: FloatArray, count: int, q: Vector, phi: float, output: Output) -> Output:
    share = seen_share(f, count, q, phi, output[2], output[3])
    if share == 0.0:
        return no_output(code.UNSEEN)
    force = output[1]
    return code.OK, (share * force[0], share * force[1], share * force[2]), output[2], output[3], output[4]
