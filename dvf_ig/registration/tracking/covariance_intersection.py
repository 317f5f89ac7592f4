"""Two estimates whose errors are correlated in a way that nobody knows, fused without a claim to more.

    P⁻¹ = ω P₁⁻¹ + (1 − ω) P₂⁻¹,    P⁻¹ x = ω P₁⁻¹ x₁ + (1 − ω) P₂⁻¹ x₂,    ω minimises det P

(of several ω that do so, as with P₁ = P₂, the one nearest to a half). P is no smaller than the true
covariance whatever the correlation is.

Source: Julier and Uhlmann 1997, A non-divergent estimation algorithm in the presence of unknown correlations.
"""

import numpy as np
from scipy.optimize import minimize_scalar

from dvf_ig.core import FloatArray

WEIGHT_TOLERANCE = 1e-3
"""Of ω: the determinant is flat at its minimum."""
FLAT = 1e-6
"""Logarithms of det P this near to each other count as the same."""


def covariance_intersection(
    first_mm2: FloatArray, second_mm2: FloatArray, offset_mm: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Fuse two estimates of the same quantity.

    Args:
        first_mm2, second_mm2: (n, n) covariances, positive definite.
        offset_mm: (n,) second estimate minus the first.
    Returns:
        (n,) fused estimate minus the first, and its (n, n) covariance.
    """
    first, second = np.linalg.inv(first_mm2), np.linalg.inv(second_mm2)

    def log_determinant(weight: float) -> float:
        size = -float(np.linalg.slogdet(weight * first + (1.0 - weight) * second)[1])
        return size + FLAT * (weight - 0.5) ** 2

    inner = minimize_scalar(
        log_determinant, bounds=(0.0, 1.0), method="bounded", options={"xatol": WEIGHT_TOLERANCE}
    )
    weight = min((0.0, 1.0, float(inner.x)), key=log_determinant)
    covariance = np.asarray(np.linalg.inv(weight * first + (1.0 - weight) * second))
    return covariance @ ((1.0 - weight) * (second @ offset_mm)), covariance
