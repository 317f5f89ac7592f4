"""Start of the search for image map and target: free linear solutions made into image maps."""

import numpy as np

from dvf_ig.core import FloatArray, ImageMap, Rigid

from .tracked_points import TrackedPoints

PIXEL_UNIT = 100.0
"""Pixels by which columns and rows are divided in linear solutions, so that all unknowns have one size."""


def centred_pixels(points: TrackedPoints) -> FloatArray:
    """Compute (f, k, 2) column, row from the middle of the region of the target, in PIXEL_UNIT."""
    return np.asarray((points.pixels - points.center_px) / PIXEL_UNIT)


def map_from_solution(solution: FloatArray, points: TrackedPoints) -> ImageMap:
    """Convert a free linear solution, whose first nine numbers are axes a, b and origin o, to an image map.

    Args:
        solution: (9 or more,) mm, for `centred_pixels`.
    """
    columns = solution[:9].reshape(3, 3).T / np.array([PIXEL_UNIT, PIXEL_UNIT, 1.0])
    columns[:, 2] -= columns[:, :2] @ points.center_px
    return _map_from_columns(columns, points.source)


def _map_from_columns(columns: FloatArray, sensor: str) -> ImageMap:
    """Approximate a (3, 3) linear map [u, v, 1] to mm, which may be far from orthogonal, by rotation · sizes.

    The bisector of the two axes is kept and both are rotated to 45° from it; an axis that is not determined
    (zero, or along the other one) becomes some direction across the other.
    """
    size = np.maximum(np.linalg.norm(columns[:, :2], axis=0), 1e-6)
    u, v = (columns[:, :2] / size).T
    if np.linalg.norm(np.cross(u, v)) < 1e-3:
        u = u / np.linalg.norm(u) if np.linalg.norm(u) > 0.5 else np.array([1.0, 0.0, 0.0])
        v = np.cross(u, np.eye(3)[int(np.abs(u).argmin())])
        v /= np.linalg.norm(v)
    along, across = u + v, u - v
    along, across = along / np.linalg.norm(along), across / np.linalg.norm(across)
    axes = np.column_stack([along + across, along - across]) / np.sqrt(2)
    rotation = np.column_stack([axes, np.cross(axes[:, 0], axes[:, 1])])
    return ImageMap(Rigid(sensor, "image", rotation, columns[:, 2]), size)
