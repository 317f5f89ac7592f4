"""Error budget of a surface extracted from a mask: measured on a ball of the same volume and voxels."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Grid, InvalidInputError

from .from_labels import FINEST_VOXEL_MM, SMOOTHING_VOXELS, surface_of_mask

_OFFSETS = np.array([[0.0, 0.0, 0.0], [0.5, 0.25, 0.0], [0.25, 0.5, 0.75], [0.75, 0.0, 0.5]])
"""Positions of the ball's centre relative to the voxels, in voxels."""


@dataclass(frozen=True, slots=True)
class SurfaceBudget:
    """Errors of the conversion from mask to surface, which a perfect mask has as well.

    Attributes:
        radius_mm: of the ball.
        voxel_mm: standard deviation of the surface about the ball, from voxels and triangles.
        shrinkage_mm: shrinkage that the Gaussian alone would cause: σ²/R.
        residual_offset_mm: mean offset left after compensation of the shrinkage; positive outwards.
        chord_mm: depth of the middle of a triangle's edge below the ball.
    """

    radius_mm: float
    voxel_mm: float
    shrinkage_mm: float
    residual_offset_mm: float
    chord_mm: float


def surface_budget(spacing_mm: FloatArray, volume_mm3: float) -> SurfaceBudget:
    """Measure the errors of the conversion from mask to surface on a ball.

    Args:
        spacing_mm: (3,) voxel pitch.
        volume_mm3: of the organ.
    Raises:
        InvalidInputError: an organ smaller than a few voxels.
    """
    radius = float((0.75 * volume_mm3 / np.pi) ** (1.0 / 3.0))
    if not radius > 2.0 * float(spacing_mm.min()):
        raise InvalidInputError(
            f"the organ encloses {volume_mm3:.0f} mm³, a few voxels of {spacing_mm.tolist()} mm; "
            "check the label values"
        )
    half = np.ceil(radius / spacing_mm).astype(int) + 2
    shape = (2 * int(half[0]) + 1, 2 * int(half[1]) + 1, 2 * int(half[2]) + 1)
    grid = Grid.axis_aligned("mr", shape, -half * spacing_mm, spacing_mm)
    centers = grid.centers_mm()
    off, edges = [], []
    for offset in _OFFSETS * spacing_mm:
        mesh = surface_of_mask(np.linalg.norm(centers - offset, axis=-1) < radius, grid)
        off.append(np.linalg.norm(mesh.vertices_mm - offset, axis=1) - radius)
        a, b, _ = (mesh.vertices_mm[mesh.triangles[:, k]] for k in range(3))
        edges.append(np.linalg.norm(a - b, axis=1))
    apart = np.concatenate(off)
    edge = float(np.sqrt(np.mean(np.concatenate(edges) ** 2)))
    block = np.maximum(FINEST_VOXEL_MM / spacing_mm, 1.0).astype(np.int64)
    sigma = SMOOTHING_VOXELS * float(np.prod(spacing_mm * block)) ** (1.0 / 3.0)
    return SurfaceBudget(
        radius, float(apart.std()), sigma**2 / radius, float(apart.mean()), edge**2 / (8.0 * radius)
    )
