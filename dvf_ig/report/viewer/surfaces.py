"""Simplify a surface through the cycle to few vertices with constant numbering, for a page to interpolate."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from dvf_ig.core import FloatArray, IntArray, Mesh, Warp, read_only_arrays
from dvf_ig.guidance import Confinement, Evaluator, Gaussian, Law

SHARE_OF_CAP = 0.1
"""Share of its cap at which a fixture's surface is shown."""
SMOOTHINGS = 3
NEWTON_STEPS = 6
LONGEST_STEP_MM = 2.0


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class CycleSurface:
    """Vertices (n, v, 3) mm of every phase, and the triangles (t, 3) of all phases."""

    vertices_mm: FloatArray
    triangles: IntArray


def cycle_surface(phases: Sequence[Mesh], pitch_mm: float) -> CycleSurface:
    """Simplify the surface of each phase to one vertex per cube of `pitch_mm`.

    Vertices of the first phase are merged and follow the surface from phase to phase: with the original
    vertices if these correspond in every phase, else along the surface's normals. Each vertex is on the
    surface in every phase.
    """
    first = phases[0]
    vertices, triangles = _merged(first, pitch_mm)
    ring = _neighbours(triangles, len(vertices))
    tree, normals = cKDTree(first.vertices_mm), vertex_normals(first)
    for _ in range(SMOOTHINGS):
        vertices = _onto(0.5 * (vertices + ring @ vertices), first, tree, normals)
    nearest = tree.query(vertices)[1]
    out = [vertices]
    for before, mesh in pairwise(phases):
        moved = out[-1]
        if np.array_equal(mesh.triangles, first.triangles) and np.array_equal(
            before.triangles, first.triangles
        ):
            moved = moved + mesh.vertices_mm[nearest] - before.vertices_mm[nearest]
        tree, normals = cKDTree(mesh.vertices_mm), vertex_normals(mesh)
        moved = _onto(moved, mesh, tree, normals)
        out.append(
            _onto(0.5 * (moved + ring @ moved), mesh, tree, normals)
        )  # smoothing keeps triangles from folding
    return CycleSurface(np.stack(out), triangles)


def fixture_surface(organ: CycleSurface, evaluator: Evaluator, level_mm: float) -> CycleSurface:
    """Find the surface of distance `level_mm` in every phase, moving the organ's vertices.

    Vertices that leave the box of the model stop there.
    """
    out = np.array(organ.vertices_mm)
    for vertices, phase in zip(out, evaluator.model.timing.fractions.tolist(), strict=True):
        for _ in range(NEWTON_STEPS):
            field = evaluator.force(vertices, phase)
            inside = np.isfinite(field.distance_mm) & np.isfinite(field.gradient).all(axis=1)
            gradient = field.gradient[inside]
            square = np.maximum((gradient**2).sum(axis=1), 0.25)
            step = ((level_mm - field.distance_mm[inside]) / square)[:, None] * gradient
            length = np.linalg.norm(step, axis=1, keepdims=True)
            vertices[inside] += step * np.minimum(1.0, LONGEST_STEP_MM / np.maximum(length, 1e-9))
    return CycleSurface(out, organ.triangles)


def shown_level_mm(law: Law) -> float:
    """Return the signed distance at which a fixture is shown: the onset of a wall, the aim of guidance."""
    if isinstance(law, Gaussian):
        return law.depth_mm
    begins_mm = -np.log(1.0 / SHARE_OF_CAP - 1.0) / law.gamma_per_mm
    if isinstance(law, Confinement):
        return float(-law.depth_mm - begins_mm)
    return float(law.depth_mm + begins_mm)


def _merged(mesh: Mesh, pitch_mm: float) -> tuple[FloatArray, IntArray]:
    """Merge the vertices in each cube to their mean; keep triangles with three different vertices."""
    cubes = np.floor(mesh.vertices_mm / pitch_mm).astype(np.int64)
    _, places = np.unique(cubes, axis=0, return_inverse=True)
    places = places.reshape(-1)
    counts = np.bincount(places)
    vertices = np.column_stack([np.bincount(places, mesh.vertices_mm[:, a]) / counts for a in range(3)])
    corners = places[mesh.triangles]
    a, b, c = corners.T
    corners = corners[(a != b) & (b != c) & (c != a)]
    if len(corners) == 0:
        return mesh.vertices_mm, mesh.triangles
    first = corners.argmin(axis=1)
    turned = np.take_along_axis(corners, (first[:, None] + np.arange(3)) % 3, axis=1)
    triangles = np.unique(turned, axis=0)
    _, sets, count = np.unique(np.sort(triangles, axis=1), axis=0, return_inverse=True, return_counts=True)
    triangles = triangles[count[sets.reshape(-1)] == 1]  # a pair of opposite triangles encloses nothing
    used, numbers = np.unique(triangles, return_inverse=True)
    return vertices[used], numbers.reshape(-1, 3).astype(np.int64)


def _neighbours(triangles: IntArray, count: int) -> sparse.csr_array:
    """Build the (v, v) matrix that averages values over neighbouring vertices."""
    a, b = triangles.ravel(), np.roll(triangles, 1, axis=1).ravel()
    rows, columns = np.concatenate([a, b]), np.concatenate([b, a])
    linked = sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    linked.data[:] = 1.0
    return sparse.csr_array(linked.multiply(1.0 / linked.sum(axis=1)[:, None]))


def vertex_normals(mesh: Mesh) -> FloatArray:
    """Compute (v, 3) unit normals, weighted by area."""
    a, b, c = (mesh.vertices_mm[mesh.triangles[:, k]] for k in range(3))
    faces = np.cross(b - a, c - a)
    sums = np.zeros_like(mesh.vertices_mm)
    for k in range(3):
        np.add.at(sums, mesh.triangles[:, k], faces)
    return np.asarray(sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12))


def normal_shifts(mesh: Mesh, now_mm: FloatArray, warp: Warp) -> tuple[FloatArray, FloatArray]:
    """Compute how far a heart that has changed its shape lies outward of a surface of its MR.

    Args:
        mesh: in the MR; now_mm: (v, 3) its vertices as the patient has them, see `Warp.patient_places`.
    Returns:
        (v,) shifts along the normals, mm, and (v,) standard deviation of a wall there.
    """
    outward_mm = np.einsum("ni,ni->n", vertex_normals(mesh), now_mm - mesh.vertices_mm)
    return np.asarray(outward_mm), np.sqrt(warp.at(now_mm)[1])


def _onto(points: FloatArray, mesh: Mesh, tree: cKDTree, normals: FloatArray) -> FloatArray:
    """Project points along the normal of the nearest vertex onto its tangent plane."""
    nearest = tree.query(points)[1]
    normal = normals[nearest]
    height = ((points - mesh.vertices_mm[nearest]) * normal).sum(axis=1, keepdims=True)
    return np.asarray(points - height * normal)
