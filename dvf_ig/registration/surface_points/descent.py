"""Robust Gauss–Newton of touched points on the model's signed distance, from one pose.

Weights of Geman–McClure, ω = 1/(1 + r²/s²)², with s from far to near.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Rigid
from dvf_ig.registration.pose_chart import PoseChart

from .distance import SurfaceDistance

REACH = 3.0
"""The last s in standard deviations of a point; then the estimate keeps 90 % of the efficiency of least
squares."""
WIDE_MM = (8.0, 5.0)
"""Scales before the last."""
STEPS, LAST_STEPS = 8, 40
"""Most steps at the wide scales, and at the last."""
CAP_MM = 8.0
"""Longest step."""
TOLERANCE_MM = 1e-4
"""A step shorter than this ends the last scale."""
DAMPING = 1e-3
"""In mean curvatures: undetermined directions take no steps."""


@dataclass(frozen=True, slots=True, eq=False)
class DescentEnd:
    """Where a descent ended, and whether its last step was shorter than TOLERANCE_MM."""

    pose: Rigid
    converged: bool


def descend(distance: SurfaceDistance, start: Rigid, sigma_mm: float, *, wide: bool = True) -> DescentEnd:
    """The robust optimum next to `start`.

    Args:
        sigma_mm: standard deviation of a point.
        wide: begin with the wide scales.
    """
    pose, converged = start, False
    last = REACH * sigma_mm
    for scale in (*(s for s in WIDE_MM if wide and s > last), last):
        for _ in range(LAST_STEPS if scale == last else STEPS):
            step = _step(distance, pose, scale)
            pose = PoseChart(pose, distance.center_mm).pose(step)
            length = float(np.linalg.norm(step))
            converged = scale == last and length < TOLERANCE_MM
            if length < (TOLERANCE_MM if scale == last else 0.05):
                break
    return DescentEnd(pose, converged)


def robust_cost(residuals_mm: FloatArray, sigma_mm: float) -> float:
    """−log of a robust likelihood, ½ Σ (r/σ)²/(1 + r²/s²): an outlier costs REACH²/2 at most."""
    square = (residuals_mm / sigma_mm) ** 2
    return float(0.5 * (square / (1.0 + square / REACH**2)).sum())


def robust_weights(residuals_mm: FloatArray, scale_mm: float) -> FloatArray:
    """(n,) ω."""
    return np.asarray(1.0 / (1.0 + (residuals_mm / scale_mm) ** 2) ** 2)


def _step(distance: SurfaceDistance, pose: Rigid, scale_mm: float) -> FloatArray:
    """(6,) in the coordinates of `PoseChart`."""
    residuals, jacobian = distance.linearised(pose)
    weighted = jacobian * robust_weights(residuals, scale_mm)[:, None]
    curvature = weighted.T @ jacobian
    mean = float(np.trace(curvature)) / 6
    if not mean > 0:
        return np.zeros(6)
    step = -np.linalg.solve(curvature + DAMPING * mean * np.eye(6), weighted.T @ residuals)
    return np.asarray(step * min(1.0, CAP_MM / max(float(np.linalg.norm(step)), 1e-12)))
