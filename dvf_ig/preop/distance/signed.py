"""Signed distance to a closed surface on a regular grid, exact near the surface; positive inside."""

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, Grid, IntArray, InvalidInputError, Mesh
from dvf_ig.kernels.mesh.winding import winding_numbers
from dvf_ig.preop.banded import BandedRows

from .triangle_tree import TriangleTree, build_triangle_tree

LEVELS = 2
"""Number of times the sampling is doubled."""
COARSE_BANDS = 3.0
"""Width of the exact band on the coarser samples, in bands. Errors 5 to 10 mm from a heart fitted with a band
of
3 mm: 0.07 mm in the mean, no more than with exact samples twice as wide; 0.10 mm with 2."""


def inside_mask(vertices_index: FloatArray, triangles: IntArray, shape: tuple[int, int, int]) -> BoolArray:
    """Flag (nx, ny, nz) nodes with a winding number other than 0; vertices in index coordinates."""
    winding = np.empty(shape, dtype=np.int16)
    winding_numbers(np.array(vertices_index, order="C"), np.array(triangles, order="C"), winding)
    return np.asarray(winding != 0)


def signed_distance_mm(mesh: Mesh, grid: Grid, band_mm: float) -> FloatArray:
    """Compute signed distance at the voxel centres of an axis-aligned grid.

    Computed on every fourth sample along each axis, then refined twice. Of every second sample, those within
    three times the band after refinement are computed exactly; in the last step, those within the band. The
    others are interpolated by cubics. The sign is that of the winding number at every sample; a sample whose
    interpolated sign differs is computed.

    Args:
        mesh: closed surface, outward orientation, in the grid's frame.
        grid: direction = identity.
        band_mm: |d| up to which every sample is exact.
    Returns:
        (nx, ny, nz) mm, positive inside.
    Raises:
        InvalidInputError: a rotated grid.
    """
    if not np.array_equal(grid.direction, np.eye(3)):
        raise InvalidInputError("the distance grid is rotated; needed one along the axes")
    tree = build_triangle_tree(mesh.vertices_mm, mesh.triangles)
    step = 1 << LEVELS
    x, y, z = (step * -(-(n - 1) // step) + 1 for n in grid.shape)
    inside = inside_mask(grid.to_index(mesh.vertices_mm), mesh.triangles, (x, y, z))
    axes = [grid.origin_mm[a] + grid.spacing_mm[a] * np.arange(n) for a, n in enumerate(inside.shape)]
    out = _exact(tree, [axis[::step] for axis in axes], inside[::step, ::step, ::step])
    while step > 1:
        step //= 2
        out = _refined(out)
        within = inside[::step, ::step, ::step]
        exact_mm = band_mm if step == 1 else COARSE_BANDS * band_mm
        near = np.nonzero((np.abs(out) <= exact_mm) | ((out > 0.0) != within))
        points = np.column_stack([axes[a][::step][near[a]] for a in range(3)])
        exact = tree.distance_mm(points)
        out[near] = np.where(within[near], exact, -exact)
    return np.ascontiguousarray(out[: grid.shape[0], : grid.shape[1], : grid.shape[2]])


def _exact(tree: TriangleTree, axes: list[FloatArray], inside: BoolArray) -> FloatArray:
    """Compute signed distance at every node of a lattice."""
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    distance = tree.distance_mm(nodes).reshape(inside.shape)
    return np.where(inside, distance, -distance)


def _refined(coarse: FloatArray) -> FloatArray:
    """Interpolate from four points to twice the density: n to 2n − 1 along each axis, n >= 2."""
    for axis in (2, 1, 0):
        coarse = _doubling(coarse.shape[axis]).along(axis, coarse)
    return coarse


def _doubling(count: int) -> BandedRows:
    """Build (2n − 1, n) weights: samples kept, and (−1, 9, 9, −1)/16 between; straight lines at both ends."""
    place = np.arange(2 * count - 1)
    width = min(4, count)
    first = np.clip(place // 2 - 1, 0, count - width)
    weights = np.zeros((len(place), width))
    weights[place[::2], place[::2] // 2 - first[::2]] = 1.0
    for side in (0, 1):
        weights[place[1::2], place[1::2] // 2 + side - first[1::2]] = 0.5
    if count > 3:
        weights[3:-3:2] = np.array([-1.0, 9.0, 9.0, -1.0]) / 16.0
    return BandedRows(first, weights, count)
