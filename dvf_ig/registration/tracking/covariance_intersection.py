"""Fusion of two pose estimates that share data, and nobody knows how much: covariance intersection.

A registration and the beats that follow it are made of the same frames, calibrations and model; taken as
independent, their fusion would claim too much.
"""

import numpy as np
from scipy.optimize import minimize_scalar

from dvf_ig.registration.pose_chart import PoseChart

from .pose_estimate import PoseEstimate


def covariance_intersection(one: PoseEstimate, other: PoseEstimate) -> PoseEstimate:
    """P⁻¹ = ω P₁⁻¹ + (1 − ω) P₂⁻¹ with the ω of least trace: consistent whatever both have in common.

    Source: Julier and Uhlmann 1997. In the coordinates of `PoseChart` about the pose of `one`.
    """
    first, second = (np.linalg.inv(estimate.covariance_mm2) for estimate in (one, other))

    def spread(weight: float) -> float:
        return float(np.trace(np.linalg.inv(weight * first + (1.0 - weight) * second)))

    within = float(minimize_scalar(spread, bounds=(0.0, 1.0), method="bounded").x)
    weight = min((0.0, within, 1.0), key=spread)
    covariance = np.asarray(np.linalg.inv(weight * first + (1.0 - weight) * second))
    chart = PoseChart(one.pose, one.center_mm)
    offset = covariance @ ((1.0 - weight) * (second @ chart.coordinates(other.pose)))
    return PoseEstimate(chart.pose(offset), covariance, one.center_mm)
