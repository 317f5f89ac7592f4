"""Guidance to a path: the distance to a polyline that may beat, its direction and its rate.

With dᵢ the distance to segment i and uᵢ the unit vector from its nearest point, d = min dᵢ and the direction
away from the path is Σ wᵢuᵢ, wᵢ ∝ exp(−(dᵢ − d)/CORNER_MM): of length 1 beside a straight part, and shorter
where parts of the path lie on opposite sides, as a gradient of distance is across a medial axis.
`dvf_ig.guidance.targets.PathTarget` is the readable form.
"""

import math
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray

from . import status as code
from .compiled import inlined, kernel
from .fixture_field import Output, force_per_gradient, no_output
from .phase import phase_bracket
from .vectors import Vector, dot

CORNER_MM = 0.5
"""Parts of a path whose distances differ by less than about this have their directions blended."""


@inlined
def _point(points: FloatArray, one: Any, two: Any, alpha: float) -> tuple[Vector, Vector]:
    """Compute a point between two phases, and its motion from the one to the other; unsigned indices."""
    x, y, z = points[one, 0], points[one, 1], points[one, 2]
    u, v, w = points[two, 0] - x, points[two, 1] - y, points[two, 2] - z
    return (x + alpha * u, y + alpha * v, z + alpha * w), (u, v, w)


@kernel
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
) -> Output:
    """Force of a Gaussian on the distance to a path; status OK or FAULT; rate in mm a cycle.

    Args:
        points: (m, 3) mm; those of this path from `first_point` on, `count` in each of its phases.
        times: (n,) phase times as fractions of the cycle, those of this path from `first_time` on.
        f: packed fixture with the path's law.
        q: point in the path's frame.
        phi: model phase.
    """
    if not math.isfinite(q[0] + q[1] + q[2] + phi):
        return no_output(code.FAULT)
    before, after, alpha, width = 0, 0, 0.0, 1.0
    if phases > 1:
        before, after, alpha, width = phase_bracket(times, first_time, phases, phi)
    one, two = np.uintp(first_point + count * before), np.uintp(first_point + count * after)
    nearest, total, rate = math.inf, 0.0, 0.0
    ax = ay = az = 0.0
    start, moved = _point(points, one, two, alpha)
    for i in range(1, count):
        end, moved_end = _point(points, one + np.uintp(i), two + np.uintp(i), alpha)
        along = (end[0] - start[0], end[1] - start[1], end[2] - start[2])
        off = (q[0] - start[0], q[1] - start[1], q[2] - start[2])
        share = min(max(dot(off, along) / dot(along, along), 0.0), 1.0)
        x, y, z = off[0] - share * along[0], off[1] - share * along[1], off[2] - share * along[2]
        size = math.sqrt(x * x + y * y + z * z)
        scale = 1.0 / size if size > 0.0 else 1.0
        x, y, z = scale * x, scale * y, scale * z
        # the nearest point keeps its share of the segment as the path moves
        drift = (
            moved[0] + share * (moved_end[0] - moved[0]),
            moved[1] + share * (moved_end[1] - moved[1]),
            moved[2] + share * (moved_end[2] - moved[2]),
        )
        start, moved = end, moved_end
        slope = -dot((x, y, z), drift) / width
        scale_down, weight = 1.0, 1.0
        if size < nearest:
            scale_down, nearest = math.exp((size - nearest) / CORNER_MM), size
        else:
            weight = math.exp((nearest - size) / CORNER_MM)
        ax, ay, az = scale_down * ax + weight * x, scale_down * ay + weight * y, scale_down * az + weight * z
        rate, total = scale_down * rate + weight * slope, scale_down * total + weight
    away = (ax / total, ay / total, az / total)
    ratio = force_per_gradient(f, nearest, math.sqrt(dot(away, away)))
    return code.OK, (ratio * away[0], ratio * away[1], ratio * away[2]), nearest, away, rate / total
