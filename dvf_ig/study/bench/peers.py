"""Other ways to the distance to a mesh, timed on the same points: Open3D, VTK, and a covariance tree.

Open3D and VTK are imported if they are installed. The covariance tree (Li and Taylor) is the mesh search
that a fixture of splines replaces: each box lies along the principal axes of its own triangles. The tree is
complete and implicit as in `closest`; leaf l of L holds triangles t·l // L to t·(l+1) // L of the leaf
order.
"""

import importlib
import logging
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from dvf_ig.core import FloatArray, Mesh
from dvf_ig.kernels.compiled import inlined, kernel
from dvf_ig.kernels.mesh.closest import DEPTH, triangle_squared_distance
from dvf_ig.kernels.mesh.winding import winding_numbers
from dvf_ig.study.bench.timing import KERNEL_CALLS, Row, row, time_batches, time_calls

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


LEAF_SIZE = 4


class CovarianceTree:
    """Complete binary tree of oriented boxes about a mesh's triangles.

    Every node is halved at the median along its longest axis; boxes fit its triangles' corners. A search
    begins at the triangle that the last one found: one tree is for one thread.
    """

    def __init__(self, mesh: Mesh) -> None:
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
        self._nodes, self._corners = nodes, triangles[order].reshape(count, 9)
        self._work = np.zeros(WORK)

    def distance_mm(self, point_mm: FloatArray) -> float:
        """Unsigned distance of one (3,) point; quickest when it is near the last one."""
        return nearest_in_covariance_tree(self._nodes, self._corners, point_mm, self._work)

    def distances_mm(self, points_mm: FloatArray) -> FloatArray:
        """(n,) unsigned distances of (n, 3) points."""
        out = np.empty(len(points_mm))
        nearest_batch(self._nodes, self._corners, points_mm, self._work, out)
        return out


def _box(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centre, (3, 3) axes as rows, and half lengths of the box along the principal axes of (n, 3) points."""
    axes = np.linalg.eigh(np.cov(points.T, bias=True))[1].T
    along = points @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    return 0.5 * (low + high) @ axes, axes, 0.5 * (high - low)


STATIC = "static python"
TREE = "static tree"
TREE_KERNEL = "static tree kernel"

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Peer:
    """A library's distance: `single` takes a prepared query, `many` (n, 3) points, both in mm."""

    name: str
    what: str
    prepare: Callable[[FloatArray], Any]
    single: Callable[[Any], Any]
    many: Callable[[FloatArray], FloatArray]
    note: str


def peer_rows(
    mesh: Mesh, path: FloatArray, exact_mm: FloatArray, *, batch: int, repeats: int
) -> Iterator[Row]:
    """Rows of every peer on the points of the path.

    Args:
        exact_mm: (n,) unsigned distances of the path.
        batch: points in a batch.
    """
    for peer in _peers(mesh):
        queries = [(peer.prepare(point),) for point in path]
        error = _error_mm(peer.many(path), exact_mm)
        yield row(peer.name, peer.what, time_calls(peer.single, queries, repeats), error, note=peer.note)
        spent = time_batches(lambda i, j, peer=peer: peer.many(path[i:j]), len(path), batch, repeats)  # type: ignore[misc]
        yield row(peer.name, "batch", spent, error, calls_per_sample=batch, note=peer.note)
    yield from _covariance_rows(mesh, path, exact_mm, batch, repeats)


def signs(mesh: Mesh, points_mm: FloatArray) -> FloatArray:
    """(n,) 1 inside a closed mesh, −1 outside, by its winding number about each point."""
    winding = np.empty((len(points_mm), 1, 1, 1), dtype=np.int16)
    triangles = np.array(mesh.triangles, order="C")
    for point_mm, node in zip(points_mm, winding, strict=True):
        winding_numbers(mesh.vertices_mm - point_mm, triangles, node)
    return np.where(winding.ravel() != 0, 1.0, -1.0)


def _error_mm(distance_mm: FloatArray, exact_mm: FloatArray) -> float:
    return float(np.sqrt(np.mean((np.abs(distance_mm) - exact_mm) ** 2)))


def _covariance_rows(
    mesh: Mesh, path: FloatArray, exact_mm: FloatArray, batch: int, repeats: int
) -> Iterator[Row]:
    tree = CovarianceTree(mesh)
    error = _error_mm(tree.distances_mm(path), exact_mm)
    note = "unsigned: spared the sign, which favours it"
    name = "covariance tree (numba)"
    spent = time_calls(tree.distance_mm, [(point,) for point in path], repeats)
    yield row(name, TREE, spent, error, note=note)
    spent = time_batches(lambda i, j: tree.distances_mm(path[i:j]), len(path), KERNEL_CALLS, repeats)
    yield row(name, TREE_KERNEL, spent, error, calls_per_sample=KERNEL_CALLS, note=note)
    spent = time_batches(lambda i, j: tree.distances_mm(path[i:j]), len(path), batch, repeats)
    yield row(name, "batch", spent, error, calls_per_sample=batch, note=note)


def _peers(mesh: Mesh) -> Iterator[Peer]:
    if _loads("open3d"):
        yield _open3d(mesh)
    if _loads("vtk"):
        yield _vtk(mesh)
    tree = cKDTree(mesh.vertices_mm)
    yield Peer(
        "scipy cKDTree",
        TREE,
        lambda point: point,
        tree.query,
        lambda points: np.asarray(tree.query(points)[0]),
        "nearest vertex, unsigned",
    )


def _loads(library: str) -> bool:
    """Whether a library can be compared with; says why if not, as where a system library is absent."""
    try:
        importlib.import_module(library)
    except (ImportError, OSError) as exc:
        _LOG.warning("%s cannot be loaded, and its rows are left out (%s)", library, exc)
        return False
    return True


def _open3d(mesh: Mesh) -> Peer:
    import open3d

    core: Any = open3d.core
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    vertices = core.Tensor(mesh.vertices_mm.astype(np.float32))
    scene.add_triangles(vertices, core.Tensor(mesh.triangles.astype(np.uint32)))
    return Peer(
        "open3d",
        STATIC,
        lambda point: core.Tensor(point[None].astype(np.float32)),
        lambda query: scene.compute_signed_distance(query, nthreads=1),
        lambda points: np.asarray(
            scene.compute_signed_distance(core.Tensor(points.astype(np.float32)), nthreads=1).numpy()
        ),
        "RaycastingScene, signed, one thread; the tensor is made beforehand",
    )


def _vtk(mesh: Mesh) -> Peer:
    vtk = importlib.import_module("vtk")
    convert = importlib.import_module("vtk.util.numpy_support")
    points = vtk.vtkPoints()
    points.SetData(convert.numpy_to_vtk(np.ascontiguousarray(mesh.vertices_mm), deep=True))
    cells = np.hstack([np.full((len(mesh.triangles), 1), 3), mesh.triangles])
    triangles = vtk.vtkCellArray()
    triangles.SetCells(len(cells), convert.numpy_to_vtkIdTypeArray(np.ascontiguousarray(cells), deep=True))
    surface = vtk.vtkPolyData()
    surface.SetPoints(points)
    surface.SetPolys(triangles)
    implicit = vtk.vtkImplicitPolyDataDistance()
    implicit.SetInput(surface)
    return Peer(
        "vtk",
        STATIC,
        lambda point: (float(point[0]), float(point[1]), float(point[2])),
        implicit.EvaluateFunction,
        lambda points: np.array([implicit.EvaluateFunction(point) for point in points.tolist()]),
        "vtkImplicitPolyDataDistance, signed",
    )
