"""Nearest triangle through a tree of oriented boxes: the mesh search that a fixture of splines replaces.

After Li and Taylor's covariance tree: each box lies along the principal axes of its own triangles. The tree
is complete and implicit as in `closest`; leaf l of L holds triangles t·l // L to t·(l+1) // L of the leaf
order.
"""

import math

from dvf_ig.core import FloatArray
from dvf_ig.kernels.compiled import inlined, kernel
from dvf_ig.kernels.mesh.closest import DEPTH, triangle_squared_distance

NODE = 15
"""Numbers a node: centre 3, three unit axes 9, half lengths along them 3."""
WORK = 2 * DEPTH + 1
"""Work space: nodes still to visit, the squared distance to each, and the triangle found last."""


@inlined
def _squared_to_box(nodes: FloatArray, node: int, x: float, y: float, z: float) -> float:
    dx, dy, dz = x - nodes[node, 0], y - nodes[node, 1], z - nodes[node, 2]
    a = abs(nodes[node, 3] * dx + nodes[node, 4] * dy + nodes[node, 5] * dz) - nodes[node, 12]
    b = abs(nodes[node, 6] * dx + nodes[node, 7] * dy + nodes[node, 8] * dz) - nodes[node, 13]
    c = abs(nodes[node, 9] * dx + nodes[node, 10] * dy + nodes[node, 11] * dz) - nodes[node, 14]
    a, b, c = max(a, 0.0), max(b, 0.0), max(c, 0.0)
    squared: float = a * a + b * b + c * c
    return squared


@kernel
def nearest_in_covariance_tree(
    nodes: FloatArray, corners: FloatArray, xyz_mm: FloatArray, work: FloatArray
) -> float:
    """Unsigned distance from one point to the nearest triangle.

    Args:
        nodes: (2L − 1, 15) boxes; corners: (t, 9) triangle corners in leaf order.
        xyz_mm: (3,) point.
        work: (WORK,) kept between calls: the triangle found for one point bounds the search of the next.
    """
    x, y, z = xyz_mm[0], xyz_mm[1], xyz_mm[2]
    leaves = (len(nodes) + 1) // 2
    nearest = int(work[WORK - 1])
    best = triangle_squared_distance(corners, nearest, x, y, z)
    work[0], work[DEPTH] = 0.0, 0.0
    count = 1
    while count > 0:
        count -= 1
        if work[DEPTH + count] >= best:
            continue
        node = int(work[count])
        while node < leaves - 1:
            near, far = 2 * node + 1, 2 * node + 2
            to_near, to_far = _squared_to_box(nodes, near, x, y, z), _squared_to_box(nodes, far, x, y, z)
            if to_near > to_far:
                near, far, to_near, to_far = far, near, to_far, to_near
            if to_near >= best:
                break
            if to_far < best:
                work[count], work[DEPTH + count] = far, to_far
                count += 1
            node = near
        if node < leaves - 1:
            continue
        leaf = node - (leaves - 1)
        for m in range(len(corners) * leaf // leaves, len(corners) * (leaf + 1) // leaves):
            squared = triangle_squared_distance(corners, m, x, y, z)
            if squared < best:
                best, nearest = squared, m
    work[WORK - 1] = nearest
    return math.sqrt(best)


@kernel
def nearest_batch(
    nodes: FloatArray, corners: FloatArray, xyz_mm: FloatArray, work: FloatArray, distance_mm: FloatArray
) -> None:
    """`nearest_in_covariance_tree` for (n, 3) points, into (n,) distances."""
    for n in range(len(xyz_mm)):
        distance_mm[n] = nearest_in_covariance_tree(nodes, corners, xyz_mm[n], work)
