"""Whether a registration may be believed: covariance, agreement, success probability."""

import math

import numpy as np

from dvf_ig.core import FloatArray

from .chart import HEART_RADIUS_MM, PoseChart, hessian
from .climb import cost_of
from .landmarks import LandmarkPrior
from .similarity import Lc2

WRONG_POSES = 24
WRONG_MM = 20.0
LOGISTIC = (-8.0, 2.0, -2.0)
"""Bias, per unit of contrast, per mm of disagreement. On tuning seeds 101–104, registrations from starts 4 to
60 mm off separate cleanly (gross failures have contrast 2.4–3.2, the others above 8), so the slope is a
choice, not a fit: even odds at contrast 4, less where the halves disagree."""


def covariance_of(metric: Lc2, chart: PoseChart, prior: LandmarkPrior | None) -> FloatArray:
    """Covariance of the pose: inverse curvature of −log posterior; NaN where that has no minimum.

    Returns:
        (6, 6): rotation vector (rad) then translation (mm), left perturbation about the chart's centre.
    """

    def cost(xi_mm: FloatArray) -> float:
        return cost_of(metric, chart.pose(xi_mm), prior)

    curvature = metric.information * hessian(cost, np.zeros(6), 0.5)
    if not np.isfinite(curvature).all() or np.linalg.eigvalsh(curvature).min() <= 0:
        return np.full((6, 6), np.nan)
    unit = np.diag([1 / HEART_RADIUS_MM] * 3 + [1.0] * 3)
    return np.asarray(unit @ np.linalg.inv(curvature) @ unit)


def contrast_of(metric: Lc2, chart: PoseChart, rng: np.random.Generator) -> float:
    """How far the similarity at a pose stands above wrong poses, in their standard deviations.

    Wrong poses are displaced by WRONG_MM at the heart's radius in random directions: the height at which this
    image quality and these views score without being registered.
    """
    directions = rng.normal(size=(WRONG_POSES, 6))
    directions *= WRONG_MM / np.linalg.norm(directions, axis=1, keepdims=True)
    wrong = np.array([metric.score(chart.pose(xi)).similarity for xi in directions])
    return float((metric.score(chart.base).similarity - wrong.mean()) / max(float(wrong.std()), 1e-12))


def success_probability(contrast: float, disagreement_mm: float) -> float:
    """Chance that the mean error over the heart is below 2 mm, from the evidence of one registration.

    A logistic in contrast and disagreement of the halves; coefficients from tuning seeds (see `LOGISTIC`).
    """
    bias, by_contrast, by_mm = LOGISTIC
    score = bias + by_contrast * min(contrast, 10.0) + by_mm * disagreement_mm
    return 1.0 / (1.0 + math.exp(-min(max(score, -30.0), 30.0)))
