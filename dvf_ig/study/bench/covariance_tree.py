"""A covariance tree over triangles (Li and Taylor): the mesh search that `dvf-ig bench` compares with."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Mesh, read_only_arrays

from .covariance_tree_kernel import NODE, WORK, nearest_batch, nearest_in_covariance_tree

LEAF_SIZE = 4


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class CovarianceTree:
    """Complete binary tree of oriented boxes.

    Attributes:
        nodes: (2L − 1, 15), see `dvf_ig.study.bench.covariance_tree_kernel`.
        corners: (t, 9) triangle corners in leaf order, mm.
    """

    nodes: FloatArray
    corners: FloatArray


class CovarianceTreeSearch:
    """Searches of one thread in a tree: each begins at the triangle that the last one found."""

    def __init__(self, tree: CovarianceTree) -> None:
        self._nodes, self._corners = tree.nodes.copy(), tree.corners.copy()
        self._work = np.zeros(WORK)

    def distance_mm(self, point_mm: FloatArray) -> float:
        """Unsigned distance of one (3,) point; quickest when it is near the last one."""
        return nearest_in_covariance_tree(self._nodes, self._corners, point_mm, self._work)

    def distances_mm(self, points_mm: FloatArray) -> FloatArray:
        """(n,) unsigned distances of (n, 3) points."""
        out = np.empty(len(points_mm))
        nearest_batch(self._nodes, self._corners, points_mm, self._work, out)
        return out


def build_covariance_tree(mesh: Mesh) -> CovarianceTree:
    """Every node is halved at the median along its longest axis; boxes fit its triangles' corners."""
    triangles = mesh.vertices_mm[mesh.triangles]
    count = len(triangles)
    levels = max(0, int(np.ceil(np.log2(count / LEAF_SIZE))))
    order = np.arange(count)
    nodes = np.empty(((2 << levels) - 1, NODE))
    for level in range(levels + 1):
        start = (np.arange((1 << level) + 1, dtype=np.int64) * count) >> level
        for k in range(1 << level):
            part = slice(start[k], start[k + 1])
            center, axes, half = _box(triangles[order[part]].reshape(-1, 3))
            nodes[(1 << level) - 1 + k] = [*center, *axes.ravel(), *half]
            if level < levels:
                along = triangles[order[part]].mean(axis=1) @ axes[int(half.argmax())]
                order[part] = order[part][np.argsort(along, kind="stable")]
    return CovarianceTree(nodes, triangles[order].reshape(count, 9))


def _box(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centre, (3, 3) axes as rows, and half lengths of the box along the principal axes of (n, 3) points."""
    axes = np.linalg.eigh(np.cov(points.T, bias=True))[1].T
    along = points @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    return 0.5 * (low + high) @ axes, axes, 0.5 * (high - low)
