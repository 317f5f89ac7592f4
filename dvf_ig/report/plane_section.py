"""Intersect a triangle mesh with a plane across a coordinate axis."""

from __future__ import annotations

import numpy as np

from dvf_ig.core.arrays import FloatArray


def plane_section(corners: FloatArray, axis: int, level: float) -> FloatArray:
    """Intersect triangles with the plane on which coordinate `axis` is `level`, as (s, 2, 3) segments.

    Args:
        corners: (t, 3, 3) corners of the triangles; none may lie in the plane.
        axis: 0, 1 or 2.
        level: position of the plane along it.
    """
    height = corners[..., axis] - level
    cut = np.flatnonzero((height.min(axis=1) < 0.0) & (height.max(axis=1) > 0.0))
    corners, height = corners[cut], height[cut]
    ends, crossing = np.empty((len(cut), 3, 3)), np.empty((len(cut), 3), dtype=np.bool_)
    for k in range(3):
        a, b = height[:, k], height[:, (k + 1) % 3]
        crossing[:, k] = (a < 0.0) != (b < 0.0)
        share = a / np.where(a == b, 1.0, a - b)
        ends[:, k] = corners[:, k] + share[:, None] * (corners[:, (k + 1) % 3] - corners[:, k])
    return np.asarray(ends[crossing].reshape(-1, 2, 3))
