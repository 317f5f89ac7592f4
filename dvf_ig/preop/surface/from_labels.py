"""Closed surfaces from a 4-D label image: smoothed mask, marching cubes, compensated shrinkage."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dvf_ig.core import (
    BoolArray,
    FloatArray,
    Grid,
    IntArray,
    InvalidInputError,
    Mesh,
    VolumeSeries,
    read_only_arrays,
)
from dvf_ig.core.progress import thread_pool
from dvf_ig.core.space.mesh import enclosed_volume_mm3
from dvf_ig.preop.components import largest_component

SMOOTHING_VOXELS = 1.0
"""Standard deviation of the Gaussian, in voxels of the geometric-mean size."""

FINEST_VOXEL_MM = 1.25
"""Largest block in which finer voxels are averaged: a spline with 3 mm knots resolves no more."""

PADDING = 4
"""Width of the background around the organ, voxels."""


def surfaces_from_labels(
    labels: VolumeSeries,
    organ_labels: Sequence[int],
    *,
    threads: int = 2,
) -> tuple[Mesh, ...]:
    """Extract the outer surface of the union of some labels: one mesh a phase, mm, outward orientation.

    The largest connected component is kept and its holes are filled. If the organ leaves the image, the
    surface is closed along the border (see border_caps).

    Args:
        labels: 4-D label image.
        organ_labels: values that belong to the organ.
        threads: phases at a time; has no influence on the result.
    Raises:
        InvalidInputError: no organ labels, or a phase without any voxel of them.
    """
    if not organ_labels:
        raise InvalidInputError("no organ labels given; name the label values that the surface encloses")
    with thread_pool(threads) as pool:
        masks = pool.map(lambda i: _organ_mask(labels, i, organ_labels), range(len(labels.timing)))
        return tuple(pool.map(lambda mask: _surface(mask, labels.grid), masks))


def surface_of_mask(mask: BoolArray, grid: Grid) -> Mesh:
    """Extract the surface of all components of one mask, smoothed as `surfaces_from_labels` smooths.

    Raises:
        InvalidInputError: an empty mask, or one of a few voxels, which the smoothing removes.
    """
    box = ndimage.find_objects(mask.view(np.int8))
    if not box:
        raise InvalidInputError("the mask has no voxel inside; there is no surface to extract")
    start = np.array([part.start for part in box[0]])
    return _surface(_Crop(mask[box[0]], start), grid)


def border_caps(mesh: Mesh, grid: Grid, axes: int = 3) -> BoolArray:
    """Flag (t,) triangles within one voxel of the image border, where the surface was cut, not imaged.

    Args:
        axes: number of axes of the grid that count: 2 of a stack, whose ends `SeenPart` describes.
    """
    index = grid.to_index(mesh.vertices_mm[mesh.triangles].mean(axis=1))[:, :axes]
    return np.asarray(((index < 1.0) | (index > np.array(grid.shape[:axes]) - 2.0)).any(axis=1))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Crop:
    """Part of a phase that holds the organ, without a border, and the index at which it starts."""

    mask: BoolArray
    start: IntArray


def _organ_mask(labels: VolumeSeries, phase: int, organ_labels: Sequence[int]) -> _Crop:
    """Crop to the largest connected component of the organ, holes filled."""
    values = labels.values[phase]
    everywhere = np.isin(values, organ_labels)
    box = ndimage.find_objects(everywhere.view(np.int8))
    if not box:
        raise InvalidInputError(
            f"phase {phase} of the label image has no voxel of the organ labels {list(organ_labels)}; "
            f"values present are {np.unique(values).tolist()[:20]}"
        )
    mask = everywhere[box[0]]
    return _Crop(largest_component(mask), np.array([part.start for part in box[0]]))


def _surface(organ: _Crop, grid: Grid) -> Mesh:
    from skimage.measure import marching_cubes

    block = np.maximum(FINEST_VOXEL_MM / grid.spacing_mm, 1.0).astype(np.int64)
    padding = PADDING * block
    solid = np.pad(organ.mask, [(int(p), int(p)) for p in padding])
    spacing_mm = grid.spacing_mm * block
    mean_mm = float(np.prod(spacing_mm)) ** (1.0 / 3.0)
    field = _shrinkage_compensated(_block_means(solid, block), SMOOTHING_VOXELS * mean_mm / spacing_mm)
    if field.max() <= 0.5:
        raise InvalidInputError(
            f"the labelled region has {np.count_nonzero(organ.mask)} voxels, fewer than a surface needs; "
            "check the label values"
        )
    vertices, triangles, _, _ = marching_cubes(field, 0.5, allow_degenerate=False)
    center_of_block = 0.5 * (block - 1)
    index = organ.start - padding + vertices.astype(np.float64) * block + center_of_block
    vertices_mm = grid.to_mm(index)
    triangles = triangles.astype(np.int64)
    if enclosed_volume_mm3(vertices_mm, triangles) < 0.0:
        triangles = triangles[:, ::-1]
    return Mesh(grid.frame, vertices_mm, triangles)


def _block_means(mask: BoolArray, block: IntArray) -> FloatArray:
    """Compute the organ's share in blocks of voxels, padded at the far end with background."""
    if (block == 1).all():
        return mask.astype(np.float64)
    whole = np.pad(mask, [(0, int(-n % b)) for n, b in zip(mask.shape, block, strict=True)])
    (nx, ny, nz), (bx, by, bz) = whole.shape, block.tolist()
    return np.asarray(whole.reshape(nx // bx, bx, ny // by, by, nz // bz, bz).mean(axis=(1, 3, 5)))


def _shrinkage_compensated(solid: FloatArray, sigma_voxels: FloatArray) -> FloatArray:
    """Apply 2 G_σ − G_2σ to the organ's share of each voxel: its half level does not shrink with curvature.

    A kernel k moves the half level of a sphere of radius R inwards by ∫ρ² k(ρ, 0)/2R over the tangent plane,
    divided by the slope of the blurred edge. A Gaussian alone gives σ²/R; σ² G_σ(0) is proportional to σ, so
    that twice the narrow Gaussian cancels the one of double width.
    """
    return np.asarray(
        2.0 * ndimage.gaussian_filter(solid, sigma_voxels, mode="constant")
        - ndimage.gaussian_filter(solid, 2.0 * sigma_voxels, mode="constant")
    )
