"""Signed distance of every voxel from the tangent plane and the foot point of the nearest surface voxel."""

import math

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import BoolArray, FloatArray

from .compiled import kernel


@kernel
def foot_point_distance(
    nearest: NDArray[np.int32],
    row: NDArray[np.int32],
    feet_mm: FloatArray,
    normals: FloatArray,
    inside: BoolArray,
    spacing_mm: FloatArray,
    plane_mm: float,
    out: NDArray[np.float32],
) -> None:
    """Compute the distance: to the plane near it, to the foot point from three times `plane_mm` on.

    Args:
        nearest: (3, nx, ny, nz) index of each voxel's nearest surface voxel.
        row: (nx, ny, nz) number of each surface voxel.
        feet_mm: (n, 3) from a surface voxel to the surface, against its normal; normals: (n, 3) inward.
        inside: (nx, ny, nz).
        plane_mm: distance up to which only the plane counts.
        out: (nx, ny, nz) mm, positive inside.
    """
    nx, ny, nz = out.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                a, b, c = nearest[0, i, j, k], nearest[1, i, j, k], nearest[2, i, j, k]
                r = row[a, b, c]
                x = (i - a) * spacing_mm[0] + feet_mm[r, 0]
                y = (j - b) * spacing_mm[1] + feet_mm[r, 1]
                z = (k - c) * spacing_mm[2] + feet_mm[r, 2]
                plane = x * normals[r, 0] + y * normals[r, 1] + z * normals[r, 2]
                length = math.sqrt(x * x + y * y + z * z)
                far = min(max((length / plane_mm - 1.0) / 2.0, 0.0), 1.0)
                point = length if inside[i, j, k] else -length
                out[i, j, k] = plane + far * (point - plane)
