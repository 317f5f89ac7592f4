"""Distance between two poses as displacement of the heart."""

import numpy as np

from dvf_ig.core.arrays import FloatArray

from .rigid import Rigid

HEART_RADIUS_MM = 40.0
"""Radius that converts rad to mm, so that rotation and translation steps move the heart equally."""


def mean_displacement_mm(first: Rigid, second: Rigid, center_mm: FloatArray) -> float:
    """Compute the mean distance in mm between two poses over six points at the heart's radius."""
    corners = np.vstack([np.eye(3), -np.eye(3)]) * HEART_RADIUS_MM + center_mm
    source = first.inverse().apply_array(corners)
    return float(np.linalg.norm(second.apply_array(source) - corners, axis=1).mean())
