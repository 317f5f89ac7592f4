"""A tree of boxes over triangles, for exact distances to a surface."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, IntArray
from dvf_ig.kernels.closest import DEPTH, closest_batch

LEAF_SIZE = 4


@dataclass(frozen=True, slots=True, eq=False)
class TriangleTree:
    """Complete binary tree; node n has children 2n+1 and 2n+2.

    Attributes:
        boxes: (2l − 1, 6) lower and upper corner of each node, mm.
        leaf_start: (l + 1,) first triangle of each leaf.
        corners: (t, 9) triangle corners in leaf order, mm.
    """

    boxes: FloatArray
    leaf_start: IntArray
    corners: FloatArray

    def distance_mm(self, xyz_mm: FloatArray) -> FloatArray:
        """(n,) unsigned exact distance; quickest when consecutive points are neighbours."""
        points = np.array(xyz_mm, dtype=np.float64, order="C")
        out = np.empty(len(points))
        pending, bound = np.empty(DEPTH, dtype=np.int64), np.empty(DEPTH)
        closest_batch(self.boxes, self.leaf_start, self.corners, points, pending, bound, out)
        return out


def build_triangle_tree(vertices_mm: FloatArray, triangles: IntArray) -> TriangleTree:
    """Tree over (t, 3) triangles: every node is split at the median along its longest side."""
    corners = vertices_mm[triangles]
    centers = corners.mean(axis=1)
    count = len(triangles)
    levels = max(0, int(np.ceil(np.log2(count / LEAF_SIZE))))
    order = np.arange(count)
    for level in range(levels):
        start = _starts(count, 1 << level)[:-1]
        node = np.repeat(np.arange(1 << level), np.diff(np.append(start, count)))
        sorted_centers = centers[order]
        extent = np.maximum.reduceat(sorted_centers, start) - np.minimum.reduceat(sorted_centers, start)
        along = np.argmax(extent, axis=1)[node]
        order = order[np.lexsort((sorted_centers[np.arange(count), along], node))]
    leaf_start = _starts(count, 1 << levels)
    return TriangleTree(_boxes(corners[order], leaf_start), leaf_start, corners[order].reshape(count, 9))


def _starts(count: int, nodes: int) -> IntArray:
    """(nodes + 1,) where each of `nodes` nearly equal shares of `count` items begins; levels nest."""
    return (np.arange(nodes + 1, dtype=np.int64) * count) // nodes


def _boxes(corners: FloatArray, leaf_start: IntArray) -> FloatArray:
    """Boxes from the leaves up to the root."""
    first = leaf_start[:-1]
    level = np.hstack(
        [
            np.minimum.reduceat(corners.min(axis=1), first),
            np.maximum.reduceat(corners.max(axis=1), first),
        ]
    )
    levels = [level]
    while len(level) > 1:
        level = np.hstack(
            [np.minimum(level[::2, :3], level[1::2, :3]), np.maximum(level[::2, 3:], level[1::2, 3:])]
        )
        levels.append(level)
    return np.ascontiguousarray(np.vstack(levels[::-1]))
