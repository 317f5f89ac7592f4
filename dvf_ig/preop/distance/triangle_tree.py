"""Bounding-volume hierarchy over triangles, for exact distances to a surface."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, IntArray, read_only_arrays
from dvf_ig.kernels.mesh.closest import DEPTH, FRAME_ROWS, LEAF_SIZE, closest_batch, fill_leaf_frames
from dvf_ig.kernels.mesh.median_tree import fill_boxes, split_at_medians


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TriangleTree:
    """Complete binary tree; node n has children 2n+1 and 2n+2.

    Attributes:
        boxes: (2l − 1, 6) lower and upper corner of each node, mm.
        leaf_start: (l + 1,) first triangle of each leaf.
        corners: (t, 9) triangle corners in leaf order, mm.
        frames: (l, 17, 8) the triangles of each leaf in their own frames; see `kernels.closest`.
        order: (t,) index in the mesh of each triangle in leaf order.
    """

    boxes: FloatArray
    leaf_start: IntArray
    corners: FloatArray
    frames: FloatArray
    order: IntArray

    def distance_mm(self, xyz_mm: FloatArray) -> FloatArray:
        """Compute (n,) unsigned exact distances; fastest when consecutive points are neighbours."""
        return self._search(xyz_mm)[0]

    def nearest(self, xyz_mm: FloatArray) -> "Nearest":
        """Find the point of the surface nearest to each of (n, 3) points."""
        distance_mm, place = self._search(xyz_mm)
        weights = nearest_weights(self.corners[place].reshape(-1, 3, 3), np.asarray(xyz_mm))
        points = np.einsum("nk,nkx->nx", weights, self.corners[place].reshape(-1, 3, 3))
        return Nearest(distance_mm, points, self.order[place], weights)

    def _search(self, xyz_mm: FloatArray) -> tuple[FloatArray, IntArray]:
        """Find distances, and the index of the nearest triangle in leaf order."""
        points = np.array(xyz_mm, dtype=np.float64, order="C")
        distance_mm, place = np.empty(len(points)), np.empty(len(points), dtype=np.int64)
        work = (np.empty(DEPTH, dtype=np.int64), np.empty(DEPTH), np.empty(LEAF_SIZE))
        closest_batch(self.boxes, self.leaf_start, self.frames, points, *work, distance_mm, place)
        return distance_mm, place


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Nearest:
    """Nearest points of a surface.

    Attributes:
        distance_mm: (n,) unsigned.
        points_mm: (n, 3) on the surface.
        triangle: (n,) of the mesh the tree was built from.
        weights: (n, 3) barycentric, of that triangle's corners; not negative.
    """

    distance_mm: FloatArray
    points_mm: FloatArray
    triangle: IntArray
    weights: FloatArray


def nearest_weights(corners: FloatArray, xyz_mm: FloatArray) -> FloatArray:
    """Compute (n, 3) barycentric weights of the point of each triangle nearest to its point.

    The foot of the perpendicular if it falls into the triangle, else the best of the three edges.

    Args:
        corners: (n, 3, 3) corner k of triangle n; xyz_mm: (n, 3).
    """
    weights = _perpendicular_weights(corners, xyz_mm)
    outside = np.flatnonzero(~(weights >= 0.0).all(axis=1))
    best = np.full(len(outside), np.inf)
    for k in range(3):
        start, side = corners[outside, k], corners[outside, (k + 1) % 3] - corners[outside, k]
        length = np.einsum("nx,nx->n", side, side)
        along = np.einsum("nx,nx->n", xyz_mm[outside] - start, side)
        t = np.clip(along / np.where(length > 0.0, length, 1.0), 0.0, 1.0)
        squared = ((start + t[:, None] * side - xyz_mm[outside]) ** 2).sum(axis=1)
        better = squared < best
        best[better] = squared[better]
        rows = outside[better]
        weights[rows] = 0.0
        weights[rows, k], weights[rows, (k + 1) % 3] = 1.0 - t[better], t[better]
    return weights


def _perpendicular_weights(corners: FloatArray, xyz_mm: FloatArray) -> FloatArray:
    """Compute (n, 3) barycentric coordinates of the feet in the triangles' planes; NaN without area."""
    b, c = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    q = xyz_mm - corners[:, 0]
    bb, bc, cc = (np.einsum("nx,nx->n", u, v) for u, v in ((b, b), (b, c), (c, c)))
    qb, qc = np.einsum("nx,nx->n", q, b), np.einsum("nx,nx->n", q, c)
    squared_area = bb * cc - bc * bc
    flat = squared_area <= 1e-12 * bb * cc
    squared_area[flat] = np.nan
    v, w = (cc * qb - bc * qc) / squared_area, (bb * qc - bc * qb) / squared_area
    return np.stack([1.0 - v - w, v, w], axis=1)


def build_triangle_tree(vertices_mm: FloatArray, triangles: IntArray) -> TriangleTree:
    """Build a tree over (t, 3) triangles: every node is split at the median along its longest side."""
    corners = vertices_mm[triangles].reshape(-1, 9)
    count = len(triangles)
    levels = max(0, int(np.ceil(np.log2(count / LEAF_SIZE))))
    centers = (corners[:, :3] + corners[:, 3:6] + corners[:, 6:]) / 3.0
    order = np.arange(count)
    split_at_medians(centers, levels, order, np.empty(count))
    corners = corners[order]
    leaf_start = (np.arange((1 << levels) + 1, dtype=np.int64) * count) // (1 << levels)
    boxes = np.empty((2 * (1 << levels) - 1, 6))
    fill_boxes(corners, leaf_start, boxes)
    frames = np.empty((1 << levels, FRAME_ROWS, LEAF_SIZE))
    fill_leaf_frames(corners, leaf_start, frames)
    return TriangleTree(boxes, leaf_start, corners, frames, order)
