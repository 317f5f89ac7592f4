"""A rigid pose as six numbers of one size.

ξ = (rotation vector · radius, translation), all in mm at the heart's radius: a left perturbation of a pose
about the heart-box centre in the fixed frame.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Rigid

HEART_RADIUS_MM = 40.0
"""Turns rad into mm, so that rotation and translation steps move the heart equally."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseChart:
    """Six coordinates about a pose; see the module docstring."""

    base: Rigid
    center_mm: FloatArray

    def pose(self, xi_mm: FloatArray) -> Rigid:
        return self.base.perturbed_left(xi_mm[:3] / HEART_RADIUS_MM, xi_mm[3:], self.center_mm)


def distance_between(first: Rigid, second: Rigid, center_mm: FloatArray, radius_mm: float) -> float:
    """Mean distance in mm between two poses over six points at `radius_mm` from the centre (fixed frame)."""
    corners = np.vstack([np.eye(3), -np.eye(3)]) * radius_mm + center_mm
    source = first.inverse().apply_array(corners)
    return float(np.linalg.norm(second.apply_array(source) - corners, axis=1).mean())


def hessian(cost: Callable[[FloatArray], float], at: FloatArray, step_mm: float) -> FloatArray:
    """(6, 6) central-difference Hessian."""
    n = len(at)
    steps = np.eye(n) * step_mm
    middle = cost(at)
    plus = np.array([cost(at + s) for s in steps])
    minus = np.array([cost(at - s) for s in steps])
    out = np.diag((plus - 2 * middle + minus) / step_mm**2)
    for i in range(n):
        for j in range(i):
            both = cost(at + steps[i] + steps[j]) + cost(at - steps[i] - steps[j])
            mixed = both - plus[i] - minus[i] - plus[j] - minus[j] + 2 * middle
            out[i, j] = out[j, i] = mixed / (2 * step_mm**2)
    return out
