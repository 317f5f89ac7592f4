"""Smooth random fields on a grid: of numbers, and of displacements without a rigid part."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from data_synth.kernels.interpolation import cubic_at
from dvf_ig.core import FloatArray, read_only_arrays


def grid_noise(
    shape: tuple[int, ...], spacing_mm: FloatArray | float, length_mm: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Draw Gaussian noise of unit RMS on a grid.

    Args:
        spacing_mm: node pitch, one or one for each axis.
        length_mm: SD of the Gaussian correlation.
    """
    sigma = np.broadcast_to(length_mm / np.sqrt(2.0) / np.asarray(spacing_mm), (len(shape),))
    out = gaussian_filter(rng.standard_normal(shape, dtype=np.float32), tuple(sigma), truncate=3.0)
    return np.asarray(out / np.sqrt((out**2).mean()), dtype=np.float32)


def wide_noise(
    shape: tuple[int, ...], spacing_mm: FloatArray | float, length_mm: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Draw `grid_noise` of a length of many nodes: at every third of its length, linear in between."""
    spacing = np.broadcast_to(np.asarray(spacing_mm, dtype=np.float64), (len(shape),))
    stride = np.maximum(np.floor(length_mm / 3.0 / spacing), 1.0)
    few = tuple(int(np.ceil((n - 1) / k)) + 2 for n, k in zip(shape, stride, strict=True))
    out = grid_noise(few, spacing * stride, length_mm, rng)
    for axis, count in enumerate(shape):
        place = np.arange(count) / stride[axis]
        first = place.astype(int)
        weight = (
            (place - first).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(len(shape))])
        )
        out = (1 - weight) * out.take(first, axis) + weight * out.take(first + 1, axis)
    return np.asarray(out, dtype=np.float32)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class GridField:
    """Displacement of space on a grid, cubic between nodes, constant outside.

    Attributes:
        displacement_mm: (nx, ny, nz, 3).
        origin_mm: (3,) first node.
        spacing_mm: node pitch, along every axis.
    """

    displacement_mm: FloatArray
    origin_mm: FloatArray
    spacing_mm: float

    def at(self, xyz_mm: FloatArray) -> FloatArray:
        """Evaluate the (n, 3) displacement at (n, 3) points."""
        points = np.ascontiguousarray(xyz_mm, dtype=np.float64)
        out = np.empty_like(points)
        cubic_at(points, self.displacement_mm, self.origin_mm, 1.0 / self.spacing_mm, out)
        return out


def grid_nodes(box_mm: FloatArray, spacing_mm: float) -> FloatArray:
    """List (nx, ny, nz, 3) nodes over a (2, 3) box and one outside it on every side."""
    count = np.ceil((box_mm[1] - box_mm[0]) / spacing_mm).astype(int) + 3
    axes = [box_mm[0, k] + spacing_mm * (np.arange(count[k]) - 1.0) for k in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def random_displacement_field(
    wide_box_mm: FloatArray,
    inner_box_mm: FloatArray,
    rms_mm: float,
    length_mm: float,
    spacing_mm: float,
    rng: np.random.Generator,
) -> GridField:
    """Draw a field of `rms_mm` (3-D) over the inner box, without translation or small rotation there.

    Args:
        wide_box_mm, inner_box_mm: (2, 3) boxes in which the field is tabulated and normalised.
        length_mm: SD of its Gaussian correlation.
        spacing_mm: node pitch of the table.
    """
    nodes = grid_nodes(wide_box_mm, spacing_mm)
    parts = [grid_noise(nodes.shape[:3], spacing_mm, length_mm, rng) for _ in range(3)]
    field = np.stack(parts, axis=-1).astype(np.float64)
    inside = ((nodes >= inner_box_mm[0]) & (nodes <= inner_box_mm[1])).all(axis=-1)
    center = inner_box_mm.mean(axis=0)
    shift, turn = small_rigid_part(nodes[inside] - center, field[inside])
    field -= shift + np.cross(turn, nodes - center)
    field *= rms_mm / np.sqrt((field[inside] ** 2).sum(axis=-1).mean())
    return GridField(field, nodes[0, 0, 0], spacing_mm)


def small_rigid_part(relative_mm: FloatArray, field_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit translation (3,) and small rotation vector (3,) to (n, 3) displacements by least squares."""
    middle = relative_mm.mean(axis=0)
    about, rest = relative_mm - middle, field_mm - field_mm.mean(axis=0)
    inertia = (about**2).sum() * np.eye(3) - about.T @ about
    turn = np.linalg.solve(inertia, np.cross(about, rest).sum(axis=0))
    return field_mm.mean(axis=0) - np.cross(turn, middle), turn


def solved_inverse(field: GridField, target_mm: FloatArray, tolerance_mm: float = 1e-4) -> FloatArray:
    """Solve x + field(x) = target for (n, 3) points x by fixed-point iteration."""
    x = np.array(target_mm, dtype=np.float64)
    for _ in range(40):
        step = target_mm - x - field.at(x)
        x += step
        if np.abs(step).max(initial=0.0) < tolerance_mm:
            break
    return x
