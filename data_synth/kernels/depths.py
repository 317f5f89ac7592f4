"""Depths below ellipsoids and tubes at many points."""

import numpy as np

from dvf_ig.core import AnyArray

from .compiled import kernel


@kernel(nogil=True, error_model="numpy")
def ellipsoid_depths(points: AnyArray, center: AnyArray, semi: AnyArray, out: AnyArray) -> None:
    """Compute first-order signed distances of (n, 3) points to an ellipsoid into `out`, positive inside."""
    least = min(semi[0], semi[1], semi[2])
    for i in range(len(points)):
        k0, k1 = 0.0, 0.0
        for k in range(3):
            scaled = (points[i, k] - center[k]) / semi[k]
            steep = scaled / semi[k]
            k0 += scaled * scaled
            k1 += steep * steep
        k0, k1 = np.sqrt(k0), np.sqrt(k1)
        out[i] = k0 * (1.0 - k0) / k1 if k1 > 1e-9 else least


@kernel(nogil=True, error_model="numpy")
def tube_depths(points: AnyArray, path: AnyArray, radii: AnyArray, out: AnyArray) -> None:
    """Compute signed distances of (n, 3) points to round cones along `path` into `out`, positive inside."""
    for i in range(len(points)):
        best = -np.inf
        for j in range(len(path) - 1):
            ax, ay, az = (
                path[j + 1, 0] - path[j, 0],
                path[j + 1, 1] - path[j, 1],
                path[j + 1, 2] - path[j, 2],
            )
            x, y, z = points[i, 0] - path[j, 0], points[i, 1] - path[j, 1], points[i, 2] - path[j, 2]
            along = min(max((x * ax + y * ay + z * az) / (ax * ax + ay * ay + az * az), 0.0), 1.0)
            x, y, z = x - along * ax, y - along * ay, z - along * az
            radius = radii[j] + (radii[j + 1] - radii[j]) * along
            best = max(best, radius - np.sqrt(x * x + y * y + z * z))
        out[i] = best
