"""Distance to a mesh by other libraries, for `dvf-ig bench`. Imports open3d and vtk where installed."""

import importlib
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from dvf_ig.core import FloatArray, Mesh, read_only_arrays
from dvf_ig.kernels.mesh.winding import winding_numbers

from .covariance_tree import CovarianceTreeSearch, build_covariance_tree
from .timing import KERNEL_CALLS, Row, row, time_batches, time_calls

STATIC = "static python"
TREE = "static tree"
TREE_KERNEL = "static tree kernel"

_LOG = logging.getLogger(__name__)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
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
    tree = CovarianceTreeSearch(build_covariance_tree(mesh))
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


def _scene(mesh: Mesh) -> Any:
    import open3d

    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    vertices = _tensor(mesh.vertices_mm.astype(np.float32))
    scene.add_triangles(vertices, _tensor(mesh.triangles.astype(np.uint32)))
    return scene


def _tensor(array: Any) -> Any:
    import open3d

    core: Any = open3d.core
    return core.Tensor(array)


def _open3d(mesh: Mesh) -> Peer:
    scene = _scene(mesh)
    return Peer(
        "open3d",
        STATIC,
        lambda point: _tensor(point[None].astype(np.float32)),
        lambda query: scene.compute_signed_distance(query, nthreads=1),
        lambda points: np.asarray(
            scene.compute_signed_distance(_tensor(points.astype(np.float32)), nthreads=1).numpy()
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
