"""Exact signed distance to a closed surface on a regular grid; positive inside."""

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, Grid, IntArray, InvalidInputError, Mesh
from dvf_ig.kernels.winding import winding_numbers

from .triangle_tree import TriangleTree, build_triangle_tree

LEVELS = 2
"""Number of times the sampling is doubled; shapes must be a multiple of 2^LEVELS, plus one."""


def inside_mask(vertices_index: FloatArray, triangles: IntArray, shape: tuple[int, int, int]) -> BoolArray:
    """(nx, ny, nz) bool: nodes with a winding number other than 0; vertices in index coordinates."""
    winding = np.empty(shape, dtype=np.int16)
    winding_numbers(np.array(vertices_index, order="C"), np.array(triangles, order="C"), winding)
    return np.asarray(winding != 0)


def signed_distance_mm(mesh: Mesh, grid: Grid, band_mm: float) -> FloatArray:
    """Signed distance at the voxel centres of an axis-aligned grid.

    Computed on every fourth sample along each axis, then refined twice: samples within twice the band, and in
    the last step within the band, are exact; the others are interpolated by cubics.

    Args:
        mesh: closed surface, outward orientation, in the grid's frame.
        grid: direction = identity, samples along each axis a multiple of four, plus one.
        band_mm: |d| up to which every sample is exact.
    Returns:
        (nx, ny, nz) mm, positive inside.
    Raises:
        InvalidInputError: a grid of another kind.
    """
    if any(n % (1 << LEVELS) != 1 for n in grid.shape) or not np.array_equal(grid.direction, np.eye(3)):
        raise InvalidInputError(
            f"distance grid has shape {grid.shape}; needed multiples of {1 << LEVELS}, plus one, "
            "and no rotation"
        )
    tree = build_triangle_tree(mesh.vertices_mm, mesh.triangles)
    inside = inside_mask(grid.to_index(mesh.vertices_mm), mesh.triangles, grid.shape)
    axes = [grid.origin_mm[a] + grid.spacing_mm[a] * np.arange(grid.shape[a]) for a in range(3)]
    step = 1 << LEVELS
    out = _exact(tree, [axis[::step] for axis in axes], inside[::step, ::step, ::step])
    while step > 1:
        step //= 2
        out = _refined(out)
        near = np.nonzero(np.abs(out) <= step * band_mm)
        points = np.column_stack([axes[a][::step][near[a]] for a in range(3)])
        exact = tree.distance_mm(points)
        out[near] = np.where(inside[::step, ::step, ::step][near], exact, -exact)
    return out


def _exact(tree: TriangleTree, axes: list[FloatArray], inside: BoolArray) -> FloatArray:
    """Signed distance at every node of a lattice."""
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    distance = tree.distance_mm(nodes).reshape(inside.shape)
    return np.where(inside, distance, -distance)


def _refined(coarse: FloatArray) -> FloatArray:
    """Four-point interpolation onto twice the density: (n, …) to (2n − 1, …) along each axis, n >= 2."""
    for axis in range(3):
        first = np.moveaxis(coarse, axis, 0)
        fine = np.empty((2 * len(first) - 1, *first.shape[1:]))
        fine[::2] = first
        fine[1::2] = 0.5 * (first[:-1] + first[1:])
        if len(first) > 3:
            fine[3:-3:2] = (9.0 * (first[1:-2] + first[2:-1]) - (first[:-3] + first[3:])) / 16.0
        coarse = np.moveaxis(fine, 0, axis)
    return np.ascontiguousarray(coarse)
