"""The paper's distance map: dilate voxel by voxel and count the layers (Ren 2008, Section III).

Not Euclidean: the count depends on the structuring element and ignores the voxels' shape. `dvf-ig study
distance` compares it as the paper's method; models are built from `signed_distance_mm`.
"""

import numpy as np
from scipy.ndimage import binary_dilation, generate_binary_structure

from dvf_ig.core import BoolArray, FloatArray, InvalidInputError

NEIGHBOURHOODS = {6: 1, 18: 2, 26: 3}
"""Neighbours of a voxel (sharing faces, edges or corners) and the rank of their structuring element."""


def dilation_distance_mm(mask: BoolArray, spacing_mm: float, neighbours: int) -> FloatArray:
    """Compute (nx, ny, nz) signed distance by counting layers, positive inside.

    The surface lies between the last voxel inside and the first outside: layer k on either side is
    (k − 1/2) voxels away.

    Args:
        mask: (nx, ny, nz) True inside.
        spacing_mm: voxel pitch, the same along each axis.
        neighbours: 6, 18 or 26.
    Raises:
        InvalidInputError: another neighbourhood, or a mask without inside or outside.
    """
    if neighbours not in NEIGHBOURHOODS:
        raise InvalidInputError(f"{neighbours} neighbours requested; choose 6, 18 or 26")
    if mask.all() or not mask.any():
        raise InvalidInputError("a distance map needs voxels inside and outside the surface")
    element = generate_binary_structure(3, NEIGHBOURHOODS[neighbours])
    layers = _layers(mask, element) - _layers(~mask, element)
    return np.asarray(-spacing_mm * (layers - 0.5 * np.sign(layers)))


def _layers(start: BoolArray, element: BoolArray) -> FloatArray:
    """Count the dilations after which each voxel is reached; 0 in the mask itself."""
    count = np.zeros(start.shape)
    reached, layer = start, 0
    while not reached.all():
        layer += 1
        grown = binary_dilation(reached, element)
        count[grown & ~reached] = layer
        reached = grown
    return count
