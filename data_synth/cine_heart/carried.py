"""Surfaces of end-diastole moved to those of end-systole, at the pace of the cine."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter1d
from scipy.sparse import csr_matrix, diags

from dvf_ig.core import FloatArray, IntArray, VolumeSeries
from dvf_ig.core.space.mesh import enclosed_volume_mm3

from .label_depth import StackDepth

ROUNDS = 40
SMOOTH_ROUNDS = 12
"""Rounds of averaging the displacement over neighbours after a step; fewer at the end."""
LONGEST_STEP_MM = 1.0
ROI_PIXELS = 8


def outline(depth: StackDepth, stride: int = 1) -> tuple[FloatArray, IntArray]:
    """Extract vertices (v, 3), frame "mr", and outward triangles (m, 3) of the surface of zero depth.

    `stride`: step of the nodes used in a slice.
    """
    from skimage.measure import marching_cubes

    nodes = depth.values_mm[::stride, ::stride]
    padded = np.pad(nodes, 1, constant_values=float(min(nodes.min(), -1.0)))
    index, faces, _, _ = marching_cubes(padded, 0.0)
    vertices = depth.grid.to_mm((np.asarray(index, dtype=np.float64) - 1.0) * np.array([stride, stride, 1]))
    triangles = np.asarray(faces, dtype=np.int64)
    if enclosed_volume_mm3(vertices, triangles) < 0:
        triangles = triangles[:, ::-1].copy()
    return vertices, triangles


def displacement(vertices_mm: FloatArray, triangles: IntArray, target: StackDepth) -> FloatArray:
    """Find the (v, 3) smooth displacement of a surface onto that of `target`.

    Each round moves along the target's gradient by its depth, 1 mm at most, and averages over neighbours,
    less and less; motion along the surface results from the averaging alone.
    """
    mean = _averaging(triangles, len(vertices_mm))
    out = np.zeros_like(vertices_mm)
    for i in range(ROUNDS):
        here = vertices_mm + out
        gradient = target.gradient(here)
        squared = np.maximum((gradient**2).sum(axis=1), 0.1)
        step = -(target.at(here) / squared)[:, None] * gradient
        length = np.linalg.norm(step, axis=1, keepdims=True)
        out += step * np.minimum(1.0, LONGEST_STEP_MM / np.maximum(length, 1e-9))
        for _ in range(round(SMOOTH_ROUNDS * (1.0 - i / ROUNDS)) + 1):
            out = mean @ out
    return out


def contraction(cine: VolumeSeries, mask: NDArray[np.bool_], es_phase: int) -> FloatArray:
    """Measure (n,) the progress of each phase of the cine from the first to end-systole, 0…1.

    The image's difference from end-diastole is projected on that of end-systole, over the labels and
    ROI_PIXELS around them, and smoothed over a frame.

    Args:
        mask: (nx, ny, nz) voxels of the heart at end-diastole.
    """
    near = binary_dilation(mask, np.ones((3, 3, 1), dtype=np.bool_), ROI_PIXELS)
    grey = np.asarray(cine.values, dtype=np.float64)[:, near]
    way = grey[es_phase] - grey[0]
    share = (grey - grey[0]) @ way / (way @ way)
    smooth = gaussian_filter1d(share, 1.0, mode="wrap")
    smooth = np.clip((smooth - smooth[0]) / (smooth[es_phase] - smooth[0]), 0.0, 1.0)
    return np.asarray(smooth)


def _averaging(triangles: IntArray, count: int) -> csr_matrix:
    """Build the average of half the vertex itself and half the mean of its neighbours."""
    a, b, c = triangles.T
    rows, columns = np.concatenate([a, b, c, b, c, a]), np.concatenate([b, c, a, a, b, c])
    near = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    near.data[:] = 1.0
    weight = diags(1.0 / np.maximum(np.asarray(near.sum(axis=1)).ravel(), 1.0))
    return csr_matrix(0.5 * diags(np.ones(count)) + 0.5 * weight @ near)
