"""Epicardial surface as a watertight mesh of an implicit depth."""

from collections.abc import Callable

import numpy as np

from dvf_ig.core import FloatArray, IntArray
from dvf_ig.core.space.mesh import enclosed_volume_mm3

Depth = Callable[[FloatArray], FloatArray]

STEP_MM = 2.75
REACH_MM = 115.0


def outline(depth: Depth, center_mm: FloatArray, step_mm: float = STEP_MM) -> tuple[FloatArray, IntArray]:
    """Extract vertices (v, 3) and outward triangles (m, 3) of the surface depth = 0 around `center_mm`.

    Marching cubes, then Newton steps along the gradient put every vertex on the surface to below 1e-4 mm.
    """
    from skimage.measure import marching_cubes

    count = int(2 * REACH_MM / step_mm) + 1
    axis = step_mm * (np.arange(count) - (count - 1) / 2)
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3) + center_mm
    values = np.concatenate([depth(part) for part in np.array_split(nodes, 16)]).reshape(count, count, count)
    raw, faces, _, _ = marching_cubes(np.clip(values, -2 * step_mm, 2 * step_mm), 0.0)
    vertices = project_to_outline(depth, raw * step_mm + axis[0] + center_mm)
    triangles = np.asarray(faces, dtype=np.int64)
    if enclosed_volume_mm3(vertices, triangles) < 0:
        triangles = triangles[:, ::-1].copy()
    return vertices, triangles


def project_to_outline(depth: Depth, points: FloatArray, steps: int = 12) -> FloatArray:
    """Move (n, 3) points along the gradient of the depth until it vanishes."""
    out = np.array(points, dtype=np.float64)
    h = 1e-3
    for _ in range(steps):
        value = depth(out)
        gradient = np.stack([(depth(out + h * e) - depth(out - h * e)) / (2 * h) for e in np.eye(3)], axis=-1)
        squared = np.maximum((gradient**2).sum(axis=-1), 0.05)
        move = -(value / squared)[:, None] * gradient
        length = np.linalg.norm(move, axis=-1, keepdims=True)
        out += move * np.minimum(1.0, 3.0 / np.maximum(length, 1e-12))
        if np.abs(value).max() < 1e-5:
            break
    return out
