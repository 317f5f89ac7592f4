"""Correction of the voxel size of an image whose header has lost it."""

import numpy as np

from dvf_ig.core import Grid, InvalidInputError


def with_voxel_size(grid: Grid, voxel_mm: tuple[float, float, float]) -> Grid:
    """Replace the voxel size of a grid; its first voxel keeps its position.

    Raises:
        InvalidInputError: a size that is not positive.
    """
    if min(voxel_mm) <= 0.0:
        raise InvalidInputError(f"the voxel size is {voxel_mm}; needed three positive numbers of mm")
    return Grid(grid.frame, grid.shape, grid.origin_mm, np.array(voxel_mm), grid.direction)
