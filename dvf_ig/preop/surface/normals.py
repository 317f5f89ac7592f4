"""Normals of a triangle surface: of its facets, and of the smooth surface that they approximate."""

import numpy as np

from dvf_ig.core import FloatArray, Mesh
from dvf_ig.preop.distance.triangle_tree import Nearest


def facet_normals(mesh: Mesh) -> FloatArray:
    """Compute (t, 3) outward unit normals; zero for a triangle without area."""
    a, b, c = (mesh.vertices_mm[mesh.triangles[:, k]] for k in range(3))
    return _unit(np.cross(b - a, c - a))


def vertex_normals(mesh: Mesh) -> FloatArray:
    """Compute (v, 3) outward unit normals: facets averaged by their angle (Thürmer and Wüthrich 1998)."""
    facets = facet_normals(mesh)
    corners = mesh.vertices_mm[mesh.triangles]
    out = np.zeros_like(mesh.vertices_mm)
    for k in range(3):
        one = _unit(corners[:, (k + 1) % 3] - corners[:, k])
        other = _unit(corners[:, (k + 2) % 3] - corners[:, k])
        angle = np.arccos(np.clip(np.einsum("tx,tx->t", one, other), -1.0, 1.0))
        for x in range(3):
            weights = angle * facets[:, x]
            out[:, x] += np.bincount(mesh.triangles[:, k], weights=weights, minlength=len(out))
    return _unit(out)


def smooth_normals(mesh: Mesh, of_vertices: FloatArray, nearest: Nearest) -> FloatArray:
    """Interpolate (n, 3) unit normals at surface points from those of the triangle's corners.

    Args:
        mesh: the surface; of_vertices: its `vertex_normals`.
        nearest: points of the surface.
    """
    return _unit(np.einsum("nk,nkx->nx", nearest.weights, of_vertices[mesh.triangles[nearest.triangle]]))


def angle_deg(one: FloatArray, other: FloatArray) -> FloatArray:
    """Compute (n,) angles between vectors; accurate for small angles, 0 if either vector is zero."""
    across = np.linalg.norm(np.cross(one, other), axis=1)
    return np.asarray(np.degrees(np.arctan2(across, np.einsum("nx,nx->n", one, other))))


def _unit(vectors: FloatArray) -> FloatArray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0.0, length, 1.0))
