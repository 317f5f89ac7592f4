"""Exact distance from points to triangles through a tree of bounding boxes (Ericson 2005, Section 5.1.5).

The tree is complete and implicit: node n has children 2n+1 and 2n+2, its last level are the leaves, and leaf
l holds triangles `leaf_start[l]` to `leaf_start[l+1]` of the reordered list (`triangle_tree`).
"""

import numpy as np

from dvf_ig.core import FloatArray, IntArray

from .compiled import inlined, kernel

DEPTH = 64
"""Capacity for pending nodes: one for each level of the tree."""


@inlined
def _squared(x: float, y: float, z: float) -> float:
    return x * x + y * y + z * z


@inlined
def _squared_to_segment(
    along: float, length: float, x: float, y: float, z: float, ux: float, uy: float, uz: float
) -> float:
    """Squared distance from (x, y, z) to the point `along / length` of u; to its start where u is null."""
    t = along / length if length > 0.0 else 0.0
    return _squared(x - t * ux, y - t * uy, z - t * uz)


@inlined
def triangle_squared_distance(corners: FloatArray, m: int, x: float, y: float, z: float) -> float:
    """Squared distance to triangle `m` of (t, 9) corner coordinates a, b, c, by Voronoi regions.

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
    """Squared distance to box `node` of (b, 6) lower and upper corners; 0 inside."""
    dx = max(boxes[node, 0] - x, 0.0, x - boxes[node, 3])
    dy = max(boxes[node, 1] - y, 0.0, y - boxes[node, 4])
    dz = max(boxes[node, 2] - z, 0.0, z - boxes[node, 5])
    return _squared(dx, dy, dz)


@kernel
def closest_batch(
    boxes: FloatArray,
    leaf_start: IntArray,
    corners: FloatArray,
    xyz_mm: FloatArray,
    pending: IntArray,
    bound: FloatArray,
    distance_mm: FloatArray,
    triangle: IntArray,
) -> None:
    """Unsigned distance from each point to the nearest triangle, into the caller's buffer.

    Consecutive points should be neighbours: the triangle found for one bounds the search of the next.

    Args:
        boxes: (2l − 1, 6) lower and upper corners of the nodes.
        leaf_start: (l + 1,) first triangle of each leaf.
        corners: (t, 9) triangle corners in leaf order.
        xyz_mm: (n, 3) points.
        pending, bound: (DEPTH,) work space: nodes still to visit, and the squared distance to each of them.
        distance_mm: (n,) output.
        triangle: (n,) output, the nearest triangle's place in leaf order.
    """
    leaves = len(leaf_start) - 1
    nearest = 0
    for n in range(len(xyz_mm)):
        x, y, z = xyz_mm[n, 0], xyz_mm[n, 1], xyz_mm[n, 2]
        best = triangle_squared_distance(corners, nearest, x, y, z)
        pending[0], bound[0] = 0, 0.0
        count = 1
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
            for m in range(leaf_start[leaf], leaf_start[leaf + 1]):
                squared = triangle_squared_distance(corners, m, x, y, z)
                if squared < best:
                    best, nearest = squared, m
        distance_mm[n] = np.sqrt(best)
        triangle[n] = nearest
