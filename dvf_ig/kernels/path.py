"""Guidance to a path: the distance to a polyline that may beat, its direction and its rate.

With dᵢ the distance to segment i and uᵢ the unit vector from its nearest point, d = min dᵢ and the direction
away from the path is Σ wᵢuᵢ, wᵢ ∝ max(0, 1 − (dᵢ − d)/CORNER_MM)²: of length 1 beside a straight part, and
shorter where parts of the path lie on opposite sides, as a gradient of distance is across a medial axis.
Segments from CORNER_MM beyond the nearest on count nothing, so most need no more than their squared distance.
`dvf_ig.guidance.targets.PathTarget` is the readable form.
"""

import math

from dvf_ig.core import FloatArray

from . import status as code
from .compiled import inlined, kernel
from .fixture_field import CONTRACTION, REST, Output, force_per_gradient, no_output
from .phase import phase_bracket
from .vectors import Vector, dot

CORNER_MM = 1.0
"""Parts of a path whose distances differ by less than this have their directions blended."""

Points = tuple[FloatArray, FloatArray, FloatArray]
"""x, y, z of a path's points, each (count,)."""


@inlined
def _phase(points: FloatArray, begin: int, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coordinates of a path in one phase."""
    end = begin + count
    return points[0, begin:end], points[1, begin:end], points[2, begin:end]


@inlined
def _point(a: Points, b: Points, alpha: float, i: int) -> Vector:
    """Compute a point between two phases."""
    return (
        a[0][i] + alpha * (b[0][i] - a[0][i]),
        a[1][i] + alpha * (b[1][i] - a[1][i]),
        a[2][i] + alpha * (b[2][i] - a[2][i]),
    )


@inlined
def _moved(a: Points, b: Points, i: int) -> Vector:
    """Compute a point's motion from one phase to the other."""
    return b[0][i] - a[0][i], b[1][i] - a[1][i], b[2][i] - a[2][i]


@inlined
def _along(start: Vector, end: Vector) -> Vector:
    return end[0] - start[0], end[1] - start[1], end[2] - start[2]


@inlined
def _from_line(start: Vector, along: Vector, share: float, q: Vector) -> Vector:
    """Compute the vector to `q` from the point at a share of a segment."""
    return (
        q[0] - start[0] - share * along[0],
        q[1] - start[1] - share * along[1],
        q[2] - start[2] - share * along[2],
    )


@kernel
def _contracted(f: FloatArray, resting: Points, phase: Points, work: FloatArray) -> Points:
    """Write a phase's points, of a heart that contracts otherwise than the model, to `work`."""
    count = len(resting[0])
    for axis in range(3):
        for i in range(count):
            start = resting[axis][i]
            work[axis, i] = start + f[CONTRACTION] * (phase[axis][i] - start)
    return work[0, :count], work[1, :count], work[2, :count]


@inlined
def _squared_distances(
    a: Points, b: Points, alpha: float, q: Vector, square: FloatArray, shares: FloatArray
) -> float:
    """Write the squared distance to each segment and its nearest point's share; return the least distance.

    The compiler vectorises the first loop, whose coordinates lie side by side.
    """
    for i in range(len(square)):
        start = _point(a, b, alpha, i)
        along = _along(start, _point(a, b, alpha, i + 1))
        share = dot(_from_line(start, along, 0.0, q), along) / dot(along, along)
        share = min(max(share, 0.0), 1.0)
        away = _from_line(start, along, share, q)
        square[i], shares[i] = dot(away, away), share
    # two minima at once: each would wait for the one before
    least, other = math.inf, math.inf
    for i in range(0, len(square) - 1, 2):
        least, other = min(least, square[i]), min(other, square[i + 1])
    return math.sqrt(min(min(least, other), square[len(square) - 1]))


@inlined
def _force_to(
    a: Points, b: Points, alpha: float, width: float, f: FloatArray, q: Vector, work: FloatArray
) -> Output:
    """Compute the force to the path between two phases; arguments as in `path_force`."""
    count = len(a[0])
    square, shares = work[0, : count - 1], work[1, : count - 1]
    nearest = _squared_distances(a, b, alpha, q, square, shares)
    reach = (nearest + CORNER_MM) * (nearest + CORNER_MM)
    total, rate = 0.0, 0.0
    ax = ay = az = 0.0
    for i in range(count - 1):
        if not square[i] < reach:
            continue
        start, share, size = _point(a, b, alpha, i), shares[i], math.sqrt(square[i])
        away = _from_line(start, _along(start, _point(a, b, alpha, i + 1)), share, q)
        rest = 1.0 - (size - nearest) / CORNER_MM
        weight = rest * rest
        scale = weight / size if size > 0.0 else weight
        x, y, z = scale * away[0], scale * away[1], scale * away[2]
        # the nearest point keeps its share of the segment as the path moves
        first, second = _moved(a, b, i), _moved(a, b, i + 1)
        drift = (
            first[0] + share * (second[0] - first[0]),
            first[1] + share * (second[1] - first[1]),
            first[2] + share * (second[2] - first[2]),
        )
        ax, ay, az = ax + x, ay + y, az + z
        rate, total = rate - dot((x, y, z), drift), total + weight
    direction = (ax / total, ay / total, az / total)
    ratio = force_per_gradient(f, nearest, math.sqrt(dot(direction, direction)))
    force = (ratio * direction[0], ratio * direction[1], ratio * direction[2])
    return code.OK, force, nearest, direction, rate / (total * width)


@kernel
def _force_to_contracted(
    a: Points,
    b: Points,
    resting: Points,
    alpha: float,
    width: float,
    f: FloatArray,
    q: Vector,
    work: FloatArray,
) -> Output:
    """Compute `_force_to` of a heart that contracts otherwise. Not inlined: few do."""
    a, b = _contracted(f, resting, a, work[2:5]), _contracted(f, resting, b, work[5:8])
    return _force_to(a, b, alpha, width, f, q, work)


@inlined
def path_force(
    points: FloatArray,
    times: FloatArray,
    first_point: int,
    count: int,
    first_time: int,
    phases: int,
    f: FloatArray,
    q: Vector,
    phi: float,
    work: FloatArray,
) -> Output:
    """Force of a Gaussian on the distance to a path; status OK or FAULT; rate in mm a cycle.

    Args:
        points: (3, m) mm; those of this path from `first_point` on, `count` in each of its phases.
        times: (n,) phase times as fractions of the cycle, those of this path from `first_time` on.
        f: packed fixture with the path's law.
        q: point in the path's frame.
        phi: model phase.
        work: (8, count) or more, working space.
    """
    if not math.isfinite(q[0] + q[1] + q[2] + phi):
        return no_output(code.FAULT)
    before, after, alpha, width = 0, 0, 0.0, 1.0
    if phases > 1:
        before, after, alpha, width = phase_bracket(times, first_time, phases, phi)
    a = _phase(points, first_point + count * before, count)
    b = _phase(points, first_point + count * after, count)
    if phases > 1 and f[CONTRACTION] != 1.0:
        resting = _phase(points, first_point + count * int(f[REST]), count)
        return _force_to_contracted(a, b, resting, alpha, width, f, q, work)
    return _force_to(a, b, alpha, width, f, q, work)
