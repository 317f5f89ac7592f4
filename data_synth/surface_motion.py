"""A dense motion of space that follows real surfaces: smooth interpolation of their vertex displacements."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.linalg import lu_factor, lu_solve
from scipy.spatial import cKDTree

from dvf_ig.core import CycleTiming, FloatArray

from .kernels import distance

NODE_MM = 3.5
CONTROL_MM = 5.0
ANCHOR_MM = 55.0
KNOTS = 50
_THREADS = 2


@dataclass(frozen=True, slots=True, eq=False)
class GriddedMotion:
    """x = X + u(X, phase): u trilinear on a grid, linear between knots at i/k of the cycle.

    Attributes:
        forward_mm: (k, nx, ny, nz, 3) float32.
        origin_mm: (3,).
        spacing_mm: node pitch.
    """

    forward_mm: NDArray[np.float32]
    origin_mm: FloatArray
    spacing_mm: float

    def nodes(self) -> FloatArray:
        """(n, 3) node positions."""
        shape = self.forward_mm.shape[1:4]
        axes = [self.origin_mm[k] + self.spacing_mm * np.arange(shape[k]) for k in range(3)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)

    def field(self, model_phase: float) -> NDArray[np.float32]:
        """(nx, ny, nz, 3) displacement at one phase."""
        count = len(self.forward_mm)
        position = (model_phase % 1.0) * count
        first = min(int(position), count - 1)
        weight = np.float32(position - first)
        return np.asarray(
            (1 - weight) * self.forward_mm[first] + weight * self.forward_mm[(first + 1) % count]
        )

    def inverse(self, xyz_mm: FloatArray, model_phase: float, guess_mm: FloatArray) -> FloatArray:
        """(n, 3) reference positions of (n, 3) points, to 1e-4 mm."""
        out = np.empty((len(xyz_mm), 3))
        distance.invert_displacement(
            np.ascontiguousarray(xyz_mm, dtype=np.float64),
            self.field(model_phase),
            self.origin_mm,
            1.0 / self.spacing_mm,
            np.ascontiguousarray(guess_mm, dtype=np.float64),
            out,
        )
        return out


def periodic_spline(timing: CycleTiming, values: FloatArray) -> CubicSpline:
    """Interpolating periodic cubic spline over the cycle of (n, …) values at the phase times."""
    times = np.append(timing.fractions, timing.fractions[0] + 1.0)
    return CubicSpline(times, np.concatenate([values, values[:1]]), bc_type="periodic")


def dense_motion(
    vertices_mm: FloatArray, timing: CycleTiming, reference_mm: FloatArray, box_mm: FloatArray
) -> GriddedMotion:
    """Interpolate vertex displacements into space with the biharmonic kernel r, at rest ANCHOR_MM outside.

    Args:
        vertices_mm: (n, v, 3) corresponding vertices of all surfaces.
        reference_mm: (v, 3) the same vertices at model phase 0.
        box_mm: (2, 3) where the motion is needed.
    """
    controls = _thinned(reference_mm, CONTROL_MM)
    anchors = _anchors(reference_mm)
    centers = np.concatenate([reference_mm[controls], anchors])
    phases = len(timing)
    shift = np.zeros((len(centers), phases, 3))
    shift[: len(controls)] = (vertices_mm[:, controls] - reference_mm[controls]).transpose(1, 0, 2)
    middle = centers.mean(axis=0)
    weights = _kernel_weights(centers - middle, shift.reshape(len(centers), -1))
    single = weights[:-4].astype(np.float32)
    count = np.ceil((box_mm[1] - box_mm[0]) / NODE_MM).astype(int) + 1
    axes = [box_mm[0, k] + NODE_MM * np.arange(count[k]) for k in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    # the spline over the cycle is linear in its values: one matrix takes phases to knots
    knots_from_phases = periodic_spline(timing, np.eye(phases))(np.arange(KNOTS) / KNOTS).astype(np.float32)
    table = np.empty((KNOTS, len(nodes), 3), dtype=np.float32)

    def fill(part: NDArray[np.int64]) -> None:
        at_phases = np.empty((len(part), 3 * phases), dtype=np.float32)
        distance.radial_field(nodes[part] - middle, centers - middle, single, weights[-4:], at_phases)
        table[:, part] = np.einsum("kp,npc->knc", knots_from_phases, at_phases.reshape(-1, phases, 3))

    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(fill, np.array_split(np.arange(len(nodes)), max(1, len(nodes) // 2000))))
    return GriddedMotion(table.reshape(KNOTS, *count, 3), np.array(box_mm[0]), NODE_MM)


def _kernel_weights(centers: FloatArray, values: FloatArray) -> FloatArray:
    """Coefficients of the kernel and of an affine part, (c + 4, k)."""
    n = len(centers)
    system = np.zeros((n + 4, n + 4))
    system[:n, :n] = _radial(centers, centers)
    affine = np.column_stack([np.ones(n), centers])
    system[:n, n:], system[n:, :n] = affine, affine.T
    right = np.concatenate([values, np.zeros((4, values.shape[1]))])
    return np.asarray(lu_solve(lu_factor(system), right))


def _radial(points: FloatArray, centers: FloatArray) -> FloatArray:
    squared = (
        (points**2).sum(axis=1)[:, None] + (centers**2).sum(axis=1)[None] - 2 * points @ centers.T
    )
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def _thinned(points: FloatArray, pitch_mm: float) -> NDArray[np.int64]:
    """Indices of a subset no two of which are closer than half the pitch: first come, first kept."""
    tree = cKDTree(points)
    dropped = np.zeros(len(points), dtype=np.bool_)
    kept = []
    for i in range(len(points)):
        if not dropped[i]:
            kept.append(i)
            dropped[tree.query_ball_point(points[i], 0.5 * pitch_mm)] = True
    return np.array(kept, dtype=np.int64)


def _anchors(points: FloatArray) -> FloatArray:
    """Points on the faces of a box ANCHOR_MM outside, which do not move."""
    low, high = points.min(axis=0) - ANCHOR_MM, points.max(axis=0) + ANCHOR_MM
    axes = [np.linspace(low[k], high[k], 6) for k in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[((grid == low) | (grid == high)).any(axis=1)]
