"""Winding number of a closed surface at each node of a grid, by scanning the columns along the third axis.

A node is inside if its winding number is not zero. Overlapping components are therefore united, and a fold
or a self-intersecting cap has only a local effect.
"""

import math

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, IntArray
from dvf_ig.kernels.compiled import inlined, kernel


@inlined
def _left_of(ax: float, ay: float, bx: float, by: float, x: float, y: float) -> bool:
    """Return whether (x, y) is left of a→b; both triangles that share the edge get the same answer (negated).

    Evaluated in one order of the end points for either direction; a point exactly on the line is moved by
    (ε, ε²), so that every column belongs to exactly one of the triangles around an edge or a vertex.
    """
    swapped = bx < ax or (bx == ax and by < ay)
    if swapped:
        ax, ay, bx, by = bx, by, ax, ay
    dx, dy = bx - ax, by - ay
    side = dx * (y - ay) - dy * (x - ax)
    if side == 0.0:
        side = -dy if dy != 0.0 else dx
    return (side > 0.0) != swapped


@kernel
def winding_numbers(vertices: FloatArray, triangles: IntArray, winding: NDArray[np.int16]) -> None:
    """Compute winding numbers at the integer nodes of a grid, into the caller's buffer.

    Args:
        vertices: (v, 3) in index coordinates of the grid.
        triangles: (t, 3), counter-clockwise from outside; closed.
        winding: (nx, ny, nz) output, 1 inside a plain surface.
    """
    nx, ny, nz = winding.shape
    winding[:] = 0
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
        bx, by, bz = vertices[b, 0], vertices[b, 1], vertices[b, 2]
        cx, cy, cz = vertices[c, 0], vertices[c, 1], vertices[c, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        upward = area > 0.0
        for i in range(max(math.ceil(min(ax, bx, cx)), 0), min(math.floor(max(ax, bx, cx)), nx - 1) + 1):
            for j in range(max(math.ceil(min(ay, by, cy)), 0), min(math.floor(max(ay, by, cy)), ny - 1) + 1):
                if (
                    _left_of(ax, ay, bx, by, i, j) != upward
                    or _left_of(bx, by, cx, cy, i, j) != upward
                    or _left_of(cx, cy, ax, ay, i, j) != upward
                ):
                    continue
                v = ((i - ax) * (cy - ay) - (j - ay) * (cx - ax)) / area
                w = ((bx - ax) * (j - ay) - (by - ay) * (i - ax)) / area
                first = max(math.ceil(az + v * (bz - az) + w * (cz - az)), 0)
                if first < nz:
                    winding[i, j, first] += -1 if upward else 1
    for i in range(nx):
        for j in range(ny):
            for k in range(1, nz):
                winding[i, j, k] += winding[i, j, k - 1]
