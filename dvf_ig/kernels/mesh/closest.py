"""Exact distance from points to triangles through a tree of bounding boxes (Ericson 2005, Section 5.1.5).

The tree is complete and implicit: node n has children 2n+1 and 2n+2, its last level holds the leaves, and
leaf l holds triangles `leaf_start[l]` to `leaf_start[l+1]` of the reordered list (`triangle_tree`). All
triangles of a leaf are tested at once, each in its own plane frame (Jones 1995): first corner at
the origin, second at (length, 0), third at (x, y) with y >= 0.
"""

import math

import numpy as np

from dvf_ig.core import FloatArray, IntArray
from dvf_ig.kernels.compiled import inlined, kernel

DEPTH = 64
"""Capacity for pending nodes, one for each level of the tree."""
LEAF_SIZE = 8
"""Most triangles in a leaf: eight of them fill one or two vector registers."""
FRAME_ROWS = 17
"""Rows of a leaf's triangles: first corner (3), axes (3 × 3), length, x, y, and 1/|side|² of the two sides
that end in the third corner (0 for one without length)."""

FLAT = 1e-12
"""Height over side below which a triangle counts as having no area."""


@inlined
def _squared(x: float, y: float, z: float) -> float:
    return x * x + y * y + z * z


@inlined
def _squared_to_segment(
    along: float, length: float, x: float, y: float, z: float, ux: float, uy: float, uz: float
) -> float:
    """Compute the squared distance from (x, y, z) to `along / length` of u; to its start if u is null."""
    t = along / length if length > 0.0 else 0.0
    return _squared(x - t * ux, y - t * uy, z - t * uz)


@inlined
def triangle_squared_distance(corners: FloatArray, m: int, x: float, y: float, z: float) -> float:
    """Compute the squared distance to triangle `m` of (t, 9) corner coordinates a, b, c, by Voronoi regions.

    A triangle without area is as far as its edges, which a closed surface's other triangles share.
    """
    ax, ay, az = x - corners[m, 0], y - corners[m, 1], z - corners[m, 2]
    bx, by, bz = corners[m, 3] - corners[m, 0], corners[m, 4] - corners[m, 1], corners[m, 5] - corners[m, 2]
    cx, cy, cz = corners[m, 6] - corners[m, 0], corners[m, 7] - corners[m, 1], corners[m, 8] - corners[m, 2]
    bb, bc, cc = _squared(bx, by, bz), bx * cx + by * cy + bz * cz, _squared(cx, cy, cz)
    d1, d2 = bx * ax + by * ay + bz * az, cx * ax + cy * ay + cz * az
    if d1 <= 0.0 and d2 <= 0.0:
        return _squared(ax, ay, az)
    d3, d4 = d1 - bb, d2 - bc
    if d3 >= 0.0 and d4 <= d3:
        return _squared(ax - bx, ay - by, az - bz)
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return _squared_to_segment(d1, d1 - d3, ax, ay, az, bx, by, bz)
    d5, d6 = d1 - bc, d2 - cc
    if d6 >= 0.0 and d5 <= d6:
        return _squared(ax - cx, ay - cy, az - cz)
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return _squared_to_segment(d2, d2 - d6, ax, ay, az, cx, cy, cz)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        along, length = d4 - d3, (d4 - d3) + (d5 - d6)
        return _squared_to_segment(along, length, ax - bx, ay - by, az - bz, cx - bx, cy - by, cz - bz)
    total = va + vb + vc
    if not total > 0.0:
        return _squared(ax, ay, az)
    v, w = vb / total, vc / total
    return _squared(ax - v * bx - w * cx, ay - v * by - w * cy, az - v * bz - w * cz)


@inlined
def _box_squared_distance(boxes: FloatArray, node: int, x: float, y: float, z: float) -> float:
    """Compute the squared distance to box `node` of (b, 6) lower and upper corners; 0 inside."""
    dx = max(boxes[node, 0] - x, 0.0, x - boxes[node, 3])
    dy = max(boxes[node, 1] - y, 0.0, y - boxes[node, 4])
    dz = max(boxes[node, 2] - z, 0.0, z - boxes[node, 5])
    return _squared(dx, dy, dz)


@inlined
def _clipped(value: float, upper: float) -> float:
    """Clip to [0, upper]; written so that the compiler makes it one vector instruction."""
    value = value if value > 0.0 else 0.0
    return value if value < upper else upper


@inlined
def _smaller(a: float, b: float) -> float:
    return a if a < b else b


@kernel
def fill_leaf_frames(corners: FloatArray, leaf_start: IntArray, frames: FloatArray) -> None:
    """Fill the frames of each leaf's triangles; a leaf's last triangle is repeated to fill it.

    A triangle without area gets any frame that holds it: none of its points counts as inside.

    Args:
        corners: (t, 9) in leaf order.
        frames: (l, FRAME_ROWS, LEAF_SIZE) output.
    """
    for leaf in range(len(frames)):
        for m in range(LEAF_SIZE):
            _fill_frame(corners, min(leaf_start[leaf] + m, leaf_start[leaf + 1] - 1), frames, leaf, m)


@inlined
def _fill_frame(corners: FloatArray, t: int, frames: FloatArray, leaf: int, m: int) -> None:
    bx, by, bz = corners[t, 3] - corners[t, 0], corners[t, 4] - corners[t, 1], corners[t, 5] - corners[t, 2]
    cx, cy, cz = corners[t, 6] - corners[t, 0], corners[t, 7] - corners[t, 1], corners[t, 8] - corners[t, 2]
    length = math.sqrt(_squared(bx, by, bz))
    reach = math.sqrt(_squared(cx, cy, cz))
    ux, uy, uz = 1.0, 0.0, 0.0
    if length > 0.0:
        ux, uy, uz = bx / length, by / length, bz / length
    elif reach > 0.0:
        ux, uy, uz = cx / reach, cy / reach, cz / reach
    along = cx * ux + cy * uy + cz * uz
    vx, vy, vz = cx - along * ux, cy - along * uy, cz - along * uz
    height = math.sqrt(_squared(vx, vy, vz))
    if not height > FLAT * reach:
        # perpendicular to u, from the axis that u is farthest from
        ax, ay, az = abs(ux), abs(uy), abs(uz)
        ex = 1.0 if ax <= ay and ax <= az else 0.0
        ey = 1.0 if ex == 0.0 and ay <= az else 0.0
        ez = 1.0 - ex - ey
        vx, vy, vz = uy * ez - uz * ey, uz * ex - ux * ez, ux * ey - uy * ex
        height = math.sqrt(_squared(vx, vy, vz))
    vx, vy, vz = vx / height, vy / height, vz / height
    across = max(cx * vx + cy * vy + cz * vz, 0.0)
    frames[leaf, 0, m], frames[leaf, 1, m], frames[leaf, 2, m] = corners[t, 0], corners[t, 1], corners[t, 2]
    frames[leaf, 3, m], frames[leaf, 4, m], frames[leaf, 5, m] = ux, uy, uz
    frames[leaf, 6, m], frames[leaf, 7, m], frames[leaf, 8, m] = vx, vy, vz
    frames[leaf, 9, m] = uy * vz - uz * vy
    frames[leaf, 10, m] = uz * vx - ux * vz
    frames[leaf, 11, m] = ux * vy - uy * vx
    frames[leaf, 12, m], frames[leaf, 13, m], frames[leaf, 14, m] = length, along, across
    from_second = (along - length) * (along - length) + across * across
    from_first = along * along + across * across
    frames[leaf, 15, m] = 1.0 / from_second if from_second > 0.0 else 0.0
    frames[leaf, 16, m] = 1.0 / from_first if from_first > 0.0 else 0.0


@inlined
def _leaf_squared_distances(
    frames: FloatArray, leaf: int, x: float, y: float, z: float, out: FloatArray
) -> None:
    """Compute squared distances to a leaf's triangles: from the plane, and in it from the nearest edge."""
    for m in range(frames.shape[2]):
        dx, dy, dz = x - frames[leaf, 0, m], y - frames[leaf, 1, m], z - frames[leaf, 2, m]
        u = dx * frames[leaf, 3, m] + dy * frames[leaf, 4, m] + dz * frames[leaf, 5, m]
        v = dx * frames[leaf, 6, m] + dy * frames[leaf, 7, m] + dz * frames[leaf, 8, m]
        w = dx * frames[leaf, 9, m] + dy * frames[leaf, 10, m] + dz * frames[leaf, 11, m]
        length, cx, cy = frames[leaf, 12, m], frames[leaf, 13, m], frames[leaf, 14, m]
        bx = cx - length
        off = u - _clipped(u, length)
        edge = off * off + v * v
        t = _clipped(((u - length) * bx + v * cy) * frames[leaf, 15, m], 1.0)
        p, q = u - length - t * bx, v - t * cy
        edge = _smaller(edge, p * p + q * q)
        t = _clipped((u * cx + v * cy) * frames[leaf, 16, m], 1.0)
        p, q = u - t * cx, v - t * cy
        edge = _smaller(edge, p * p + q * q)
        inside = (v > 0.0) & (bx * v - cy * (u - length) > 0.0) & (cy * u - cx * v > 0.0)
        out[m] = w * w + (0.0 if inside else edge)


@kernel
def closest_batch(
    boxes: FloatArray,
    leaf_start: IntArray,
    frames: FloatArray,
    xyz_mm: FloatArray,
    pending: IntArray,
    bound: FloatArray,
    squared: FloatArray,
    distance_mm: FloatArray,
    triangle: IntArray,
) -> None:
    """Compute unsigned distances from each point to the nearest triangle, into the caller's buffer.

    Consecutive points should be neighbours: the leaf of the triangle found for one bounds the search of the
    next.

    Args:
        boxes: (2l − 1, 6) lower and upper corners of the nodes.
        leaf_start: (l + 1,) first triangle of each leaf.
        frames: (l, FRAME_ROWS, LEAF_SIZE) from `fill_leaf_frames`.
        xyz_mm: (n, 3) points.
        pending, bound: (DEPTH,) work space: nodes still to visit, and the squared distance to each of them.
        squared: (LEAF_SIZE,) work space.
        distance_mm: (n,) output.
        triangle: (n,) output, the nearest triangle's index in leaf order.
    """
    leaves = len(leaf_start) - 1
    start, nearest = 0, 0
    for n in range(len(xyz_mm)):
        x, y, z = xyz_mm[n, 0], xyz_mm[n, 1], xyz_mm[n, 2]
        best = np.inf
        pending[0], bound[0] = 0, 0.0
        pending[1], bound[1] = start + leaves - 1, 0.0
        count = 2
        while count > 0:
            count -= 1
            if bound[count] >= best:
                continue
            node = pending[count]
            while node < leaves - 1:
                near, far = 2 * node + 1, 2 * node + 2
                to_near = _box_squared_distance(boxes, near, x, y, z)
                to_far = _box_squared_distance(boxes, far, x, y, z)
                if to_near > to_far:
                    near, far, to_near, to_far = far, near, to_far, to_near
                if to_near >= best:
                    break
                if to_far < best:
                    pending[count], bound[count] = far, to_far
                    count += 1
                node = near
            if node < leaves - 1:
                continue
            leaf = node - (leaves - 1)
            _leaf_squared_distances(frames, leaf, x, y, z, squared)
            for m in range(leaf_start[leaf + 1] - leaf_start[leaf]):
                if squared[m] < best:
                    best, start, nearest = squared[m], leaf, leaf_start[leaf] + m
        distance_mm[n] = np.sqrt(best)
        triangle[n] = nearest
