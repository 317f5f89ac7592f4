"""A surface through the cycle with few vertices that keep their numbers, for a page to interpolate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from dvf_ig.core.arrays import FloatArray, IntArray, read_only_arrays
from dvf_ig.core.space.mesh import Mesh
from dvf_ig.guidance import Confinement, Evaluator, Gaussian, Law

SHARE_OF_CAP = 0.1
"""A fixture is shown where its force reaches this share of its cap."""
SMOOTHINGS = 3
NEWTON_STEPS = 6
LONGEST_STEP_MM = 2.0


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class CycleSurface:
    """Vertices (n, v, 3) mm of every phase, and the triangles (t, 3) of all."""

    vertices_mm: FloatArray
    triangles: IntArray


def cycle_surface(phases: Sequence[Mesh], pitch_mm: float) -> CycleSurface:
    """The surface of each phase with one vertex a cube of `pitch_mm`.

    Vertices of the first phase are merged and follow the surface from phase to phase: with their neighbours
    where these are the same points in every phase, else along the surface's normals. So each lies on the
    surface of every phase.
    """
    first = phases[0]
    vertices, triangles = _merged(first, pitch_mm)
    ring = _neighbours(triangles, len(vertices))
    tree, normals = cKDTree(first.vertices_mm), _normals(first)
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
        tree, normals = cKDTree(mesh.vertices_mm), _normals(mesh)
        moved = _onto(moved, mesh, tree, normals)
        out.append(_onto(0.5 * (moved + ring @ moved), mesh, tree, normals))  # or triangles would fold
    return CycleSurface(np.stack(out), triangles)


def fixture_surface(organ: CycleSurface, evaluator: Evaluator, level_mm: float) -> CycleSurface:
    """Where the distance is `level_mm` in every phase: the organ's vertices moved along its gradient.

    Vertices that leave the box of the model stay where they left it.
    """
    out = np.array(organ.vertices_mm)
    for vertices, phase in zip(out, evaluator.model.timing.fractions.tolist(), strict=True):
        for _ in range(NEWTON_STEPS):
            field = evaluator.force(vertices, phase)
            known = np.isfinite(field.distance_mm) & np.isfinite(field.gradient).all(axis=1)
            gradient = field.gradient[known]
            square = np.maximum((gradient**2).sum(axis=1), 0.25)
            step = ((level_mm - field.distance_mm[known]) / square)[:, None] * gradient
            length = np.linalg.norm(step, axis=1, keepdims=True)
            vertices[known] += step * np.minimum(1.0, LONGEST_STEP_MM / np.maximum(length, 1e-9))
    return CycleSurface(out, organ.triangles)


def shown_level_mm(law: Law) -> float:
    """Signed distance at which a fixture is shown: where a wall begins to be felt, where guidance aims."""
    if isinstance(law, Gaussian):
        return law.depth_mm
    begins_mm = -np.log(1.0 / SHARE_OF_CAP - 1.0) / law.gamma_per_mm
    if isinstance(law, Confinement):
        return float(-law.depth_mm - begins_mm)
    return float(law.depth_mm + begins_mm)


def _merged(mesh: Mesh, pitch_mm: float) -> tuple[FloatArray, IntArray]:
    """One vertex, the mean, for each cube that holds any; triangles with three different ones."""
    cubes = np.floor(mesh.vertices_mm / pitch_mm).astype(np.int64)
    _, places = np.unique(cubes, axis=0, return_inverse=True)
    places = places.reshape(-1)
    held = np.bincount(places)
    vertices = np.column_stack([np.bincount(places, mesh.vertices_mm[:, a]) / held for a in range(3)])
    corners = places[mesh.triangles]
    a, b, c = corners.T
    corners = corners[(a != b) & (b != c) & (c != a)]
    if len(corners) == 0:
        return mesh.vertices_mm, mesh.triangles
    first = corners.argmin(axis=1)
    turned = np.take_along_axis(corners, (first[:, None] + np.arange(3)) % 3, axis=1)
    triangles = np.unique(turned, axis=0)
    _, sets, count = np.unique(np.sort(triangles, axis=1), axis=0, return_inverse=True, return_counts=True)
    triangles = triangles[count[sets.reshape(-1)] == 1]  # two that face each other enclose nothing
    used, numbers = np.unique(triangles, return_inverse=True)
    return vertices[used], numbers.reshape(-1, 3).astype(np.int64)


def _neighbours(triangles: IntArray, count: int) -> sparse.csr_array:
    """(v, v) that takes values at vertices to the means of their neighbours."""
    a, b = triangles.ravel(), np.roll(triangles, 1, axis=1).ravel()
    rows, columns = np.concatenate([a, b]), np.concatenate([b, a])
    linked = sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    linked.data[:] = 1.0
    return sparse.csr_array(linked.multiply(1.0 / linked.sum(axis=1)[:, None]))


def _normals(mesh: Mesh) -> FloatArray:
    """(v, 3) unit normals, weighted by area."""
    a, b, c = (mesh.vertices_mm[mesh.triangles[:, k]] for k in range(3))
    faces = np.cross(b - a, c - a)
    sums = np.zeros_like(mesh.vertices_mm)
    for k in range(3):
        np.add.at(sums, mesh.triangles[:, k], faces)
    return np.asarray(sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12))


def _onto(points: FloatArray, mesh: Mesh, tree: cKDTree, normals: FloatArray) -> FloatArray:
    """Points moved along the normal of the nearest vertex into its tangent plane."""
    nearest = tree.query(points)[1]
    normal = normals[nearest]
    height = ((points - mesh.vertices_mm[nearest]) * normal).sum(axis=1, keepdims=True)
    return np.asarray(points - height * normal)
