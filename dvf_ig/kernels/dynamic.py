"""The dynamic virtual fixture in one call: pose, phase bracket, two splines, law, blend, force turned back.

Corrected eq. 10: F = (1−α) F(V_i) + α F(V_{i+1}); as printed, the weights are swapped and the force jumps at
every frame switch (theory: fixtures).
"""

import math

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, IntArray

from . import status as code
from .compiled import inlined, kernel
from .laws import direction_certainty, signed_potential
from .spline import Lanes, cell_of, cell_value_gradient, cubic_weights, inside_box

BLEND_FORCE = 0
BLEND_DISTANCE = 1

Vector = tuple[float, float, float]
Answer = tuple[int, float, float, float, float, float, float, float]
"""Status, force (N), distance (mm), gradient."""


@inlined
def phase_bracket(fractions: FloatArray, phi: float) -> tuple[int, int, float]:
    """Neighbouring phases of `phi` (cyclic) and the weight of the second, as CycleTiming.bracket."""
    phi -= math.floor(phi)
    low, high = 0, len(fractions)
    while low < high:
        middle = (low + high) // 2
        if fractions[middle] <= phi:
            low = middle + 1
        else:
            high = middle
    second = low if low < len(fractions) else 0
    first = low - 1 if low > 0 else len(fractions) - 1
    width = fractions[second] - fractions[first]
    past = phi - fractions[first]
    width = width + 1.0 if width <= 0.0 else width
    past = past + 1.0 if past < 0.0 else past
    return first, second, past / width


@inlined
def _push(law: FloatArray, s_mm: float, norm: float) -> float:
    """Force per unit of gradient: −cap·f(s)·certainty/|∇d|; zero where there is no direction."""
    certainty = direction_certainty(norm)
    if certainty == 0.0:
        return 0.0
    push: float = -law[3] * signed_potential(int(law[0]), law[1], law[2], s_mm) * certainty / norm
    return push


@inlined
def _blend_forces(law: FloatArray, a: Lanes, b: Lanes, alpha: float) -> Vector:
    """Corrected eq. 10; `a`, `b` are (distance, gradient) of the two phases."""
    first = (1.0 - alpha) * _push(law, a[0] - law[4], math.sqrt(a[1] * a[1] + a[2] * a[2] + a[3] * a[3]))
    second = alpha * _push(law, b[0] - law[4], math.sqrt(b[1] * b[1] + b[2] * b[2] + b[3] * b[3]))
    return first * a[1] + second * b[1], first * a[2] + second * b[2], first * a[3] + second * b[3]


@inlined
def _mix(a: Lanes, b: Lanes, alpha: float) -> Lanes:
    rest = 1.0 - alpha
    return (
        rest * a[0] + alpha * b[0],
        rest * a[1] + alpha * b[1],
        rest * a[2] + alpha * b[2],
        rest * a[3] + alpha * b[3],
    )


@inlined
def _law_of_mix(law: FloatArray, mixed: Lanes) -> Vector:
    """One law on the blended field; d/|∇d| because a blend of distances is steeper than no distance."""
    norm = math.sqrt(mixed[1] * mixed[1] + mixed[2] * mixed[2] + mixed[3] * mixed[3])
    push = _push(law, mixed[0] / norm - law[4], norm) if norm > 0.0 else 0.0
    return push * mixed[1], push * mixed[2], push * mixed[3]


@inlined
def _force_at(
    coefficients: NDArray[np.float32],
    origin_mm: FloatArray,
    per_knot: float,
    fractions: FloatArray,
    law: FloatArray,
    blend: int,
    q: Vector,
    phi: float,
) -> Answer:
    """Force at one point of the model's frame."""
    cells = (coefficients.shape[1] - 3, coefficients.shape[2] - 3, coefficients.shape[3] - 3)
    u = (q[0] - origin_mm[0]) * per_knot
    v = (q[1] - origin_mm[1]) * per_knot
    w = (q[2] - origin_mm[2]) * per_knot
    if not math.isfinite(u + v + w + phi):
        return code.FAULT, 0.0, 0.0, 0.0, math.nan, math.nan, math.nan, math.nan
    if not inside_box(u, v, w, cells):
        return code.OUT_OF_VOLUME, 0.0, 0.0, 0.0, math.nan, math.nan, math.nan, math.nan
    first, second, alpha = phase_bracket(fractions, phi)
    i, j, k = cell_of(u, cells[0]), cell_of(v, cells[1]), cell_of(w, cells[2])
    x, y, z = cubic_weights(u - i), cubic_weights(v - j), cubic_weights(w - k)
    d, gx, gy, gz = cell_value_gradient(coefficients, np.uintp(first), (i, j, k), x, y, z)
    a = (d, gx * per_knot, gy * per_knot, gz * per_knot)
    d, gx, gy, gz = cell_value_gradient(coefficients, np.uintp(second), (i, j, k), x, y, z)
    b = (d, gx * per_knot, gy * per_knot, gz * per_knot)
    m = _mix(a, b, alpha)
    fx, fy, fz = _law_of_mix(law, m) if blend == BLEND_DISTANCE else _blend_forces(law, a, b, alpha)
    if not math.isfinite(fx + fy + fz):
        return code.FAULT, 0.0, 0.0, 0.0, math.nan, math.nan, math.nan, math.nan
    return code.OK, fx, fy, fz, m[0], m[1], m[2], m[3]


@inlined
def _moved(pose: FloatArray, x: float, y: float, z: float) -> Vector:
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3],
    )


@inlined
def _turned_back(pose: FloatArray, x: float, y: float, z: float) -> Vector:
    """Rᵀ v: a free vector of the target frame in the source frame."""
    return (
        pose[0, 0] * x + pose[1, 0] * y + pose[2, 0] * z,
        pose[0, 1] * x + pose[1, 1] * y + pose[2, 1] * z,
        pose[0, 2] * x + pose[1, 2] * y + pose[2, 2] * z,
    )


@kernel
def force_tick(
    coefficients: NDArray[np.float32],
    origin_mm: FloatArray,
    knot_mm: float,
    fractions: FloatArray,
    law: FloatArray,
    blend: int,
    model_from_query: FloatArray,
    xyz_mm: FloatArray,
    phi: float,
    known: int,
    out: FloatArray,
) -> int:
    """Force at one point; the call of a servo loop.

    Args:
        coefficients: (n, cx, cy, cz) mm; origin_mm: (3,); knot_mm: knot pitch.
        fractions: (n,) phase times as fractions of the cycle.
        law: (5,) kind, scale, exponent, cap in N, guarded depth in mm (dvf_ig.guidance laws).
        blend: BLEND_FORCE or BLEND_DISTANCE.
        model_from_query: (3, 4) rigid map of `xyz_mm` into the model's frame.
        xyz_mm: (3,) point in the query frame.
        phi: model phase.
        known: status of everything that led here; anything but OK is passed on with zero force.
        out: (7,) force in N, distance in mm, gradient of distance; vectors in the query frame.
    Returns:
        status code; unless OK the force is zero and the rest NaN.
    """
    status = known
    fx = fy = fz = 0.0
    d = gx = gy = gz = math.nan
    if status == code.OK:
        q = _moved(model_from_query, xyz_mm[0], xyz_mm[1], xyz_mm[2])
        status, fx, fy, fz, d, gx, gy, gz = _force_at(
            coefficients, origin_mm, 1.0 / knot_mm, fractions, law, blend, q, phi
        )
    out[0], out[1], out[2] = _turned_back(model_from_query, fx, fy, fz)
    out[3] = d
    out[4], out[5], out[6] = _turned_back(model_from_query, gx, gy, gz)
    return status


PACKED_HEAD = 22
"""Numbers before the phase times in a packed fixture: origin 3, knot, blend, law 5, pose 12."""


def packed_fixture(
    origin_mm: FloatArray,
    knot_mm: float,
    fractions: FloatArray,
    law: FloatArray,
    blend: int,
    model_from_query: FloatArray,
) -> FloatArray:
    """Everything but the coefficients in one array: each array argument costs a call from Python 0.15 µs."""
    head = [origin_mm, [knot_mm, float(blend)], law, model_from_query.ravel()]
    return np.concatenate([*head, fractions])


@kernel
def force_tick_packed(
    coefficients: NDArray[np.float32],
    packed: FloatArray,
    xyz_mm: FloatArray,
    phi: float,
    known: int,
    out: FloatArray,
) -> int:
    """`force_tick` with its constants in one array made by `packed_fixture`."""
    return force_tick(
        coefficients,
        packed[0:3],
        packed[3],
        packed[PACKED_HEAD:],
        packed[5:10],
        int(packed[4]),
        packed[10:PACKED_HEAD].reshape(3, 4),
        xyz_mm,
        phi,
        known,
        out,
    )


@kernel
def force_batch(
    coefficients: NDArray[np.float32],
    origin_mm: FloatArray,
    knot_mm: float,
    fractions: FloatArray,
    law: FloatArray,
    blend: int,
    model_from_query: FloatArray,
    xyz_mm: FloatArray,
    phi: FloatArray,
    force_n: FloatArray,
    distance_mm: FloatArray,
    gradient: FloatArray,
    status: IntArray,
) -> None:
    """`force_tick` for (k, 3) points and (k,) phases; entries whose `status` comes in not OK get no force."""
    per_knot = 1.0 / knot_mm
    for n in range(len(xyz_mm)):
        fx = fy = fz = 0.0
        d = gx = gy = gz = math.nan
        if status[n] == code.OK:
            q = _moved(model_from_query, xyz_mm[n, 0], xyz_mm[n, 1], xyz_mm[n, 2])
            status[n], fx, fy, fz, d, gx, gy, gz = _force_at(
                coefficients, origin_mm, per_knot, fractions, law, blend, q, phi[n]
            )
        force_n[n, 0], force_n[n, 1], force_n[n, 2] = _turned_back(model_from_query, fx, fy, fz)
        distance_mm[n] = d
        gradient[n, 0], gradient[n, 1], gradient[n, 2] = _turned_back(model_from_query, gx, gy, gz)
