"""From a 4-D label image to closed surfaces: smoothed mask, marching cubes, no shrinkage to first order."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy import ndimage

from dvf_ig.core import AnyArray, BoolArray, FloatArray, Grid, InvalidInputError, Mesh, VolumeSeries
from dvf_ig.core.mesh import enclosed_volume_mm3

SMOOTHING_VOXELS = 1.0
"""Standard deviation of the Gaussian, in voxels of the geometric-mean size."""

PADDING = 4
"""Voxels of background around the organ."""


def surfaces_from_labels(
    labels: VolumeSeries,
    organ_labels: Sequence[int],
    *,
    smoothing_voxels: float = SMOOTHING_VOXELS,
    threads: int = 2,
) -> tuple[Mesh, ...]:
    """Outer surface of the union of some labels, one mesh a phase, in mm, outward orientation.

    Of several separate pieces the largest is kept, and what it encloses is filled. Where the organ leaves the
    image, the surface is closed along the border (see border_caps).

    Args:
        labels: 4-D label image.
        organ_labels: values that belong to the organ.
        smoothing_voxels: width of the smoothing.
        threads: phases at a time; has no influence on the result.
    Raises:
        InvalidInputError: no organ labels, or a phase without any voxel of them.
    """
    if not organ_labels:
        raise InvalidInputError("no organ labels given; name the label values that the surface encloses")
    for i, phase in enumerate(labels.values):
        if not np.isin(phase, organ_labels).any():
            raise InvalidInputError(
                f"phase {i} of the label image has no voxel of the organ labels {list(organ_labels)}; "
                f"values present are {np.unique(phase).tolist()[:20]}"
            )
    with ThreadPoolExecutor(threads) as pool:
        return tuple(
            pool.map(
                lambda phase: _surface(phase, labels.grid, organ_labels, smoothing_voxels), labels.values
            )
        )


def border_caps(mesh: Mesh, grid: Grid) -> BoolArray:
    """(t,) True for triangles within one voxel of the image border: there the surface was cut, not seen."""
    index = grid.to_index(mesh.vertices_mm[mesh.triangles].mean(axis=1))
    return np.asarray(((index < 1.0) | (index > np.array(grid.shape) - 2.0)).any(axis=1))


def _surface(phase: AnyArray, grid: Grid, organ_labels: Sequence[int], smoothing_voxels: float) -> Mesh:
    from skimage.measure import marching_cubes

    mask, start = _organ(np.isin(phase, organ_labels))
    mean_mm = float(np.prod(grid.spacing_mm)) ** (1.0 / 3.0)
    field = _unshrunk(mask, smoothing_voxels * mean_mm / grid.spacing_mm)
    vertices, triangles, _, _ = marching_cubes(field, 0.5, allow_degenerate=False)
    vertices_mm = grid.to_mm(vertices.astype(np.float64) + start)
    triangles = triangles.astype(np.int64)
    if enclosed_volume_mm3(vertices_mm, triangles) < 0.0:
        triangles = triangles[:, ::-1]
    return Mesh(grid.frame, vertices_mm, triangles)


def _organ(mask: BoolArray) -> tuple[BoolArray, FloatArray]:
    """Largest piece, filled, cropped and padded with background; and the index at which the crop starts."""
    pieces, count = ndimage.label(mask)
    if count > 1:
        mask = pieces == 1 + int(np.argmax(np.bincount(pieces.ravel())[1:]))
    mask = ndimage.binary_fill_holes(mask)
    box = ndimage.find_objects(mask.astype(np.int8))[0]
    start = np.array([part.start for part in box], dtype=np.float64) - PADDING
    return np.pad(mask[box], PADDING), start


def _unshrunk(mask: BoolArray, sigma_voxels: FloatArray) -> FloatArray:
    """2 G_σ − G_2σ applied to the mask: to first order in curvature its half level stays where it was.

    A kernel k moves the half level of a sphere of radius R inwards by ∫ρ² k(ρ, 0)/2R over the tangent plane,
    divided by the slope of the blurred edge. A Gaussian alone gives σ²/R; σ² G_σ(0) is proportional to σ, so
    that twice the narrow one cancels one twice as wide.
    """
    solid = mask.astype(np.float64)
    return np.asarray(
        2.0 * ndimage.gaussian_filter(solid, sigma_voxels, mode="constant")
        - ndimage.gaussian_filter(solid, 2.0 * sigma_voxels, mode="constant")
    )
