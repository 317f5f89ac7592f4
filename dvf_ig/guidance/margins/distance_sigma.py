"""Standard deviation of the signed distance at the tool's tip, by each of its causes."""

import math
from typing import NamedTuple

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.core.arrays import check_shape


class DistanceSigma(NamedTuple):
    """One standard deviation of d by each cause, (n,) mm; the causes are taken as independent."""

    registration_mm: FloatArray
    shape_mm: FloatArray
    calibration_mm: FloatArray
    phase_mm: FloatArray
    breathing_mm: FloatArray
    tracking_mm: FloatArray

    @property
    def total_mm(self) -> FloatArray:
        """(n,) root of the sum of squares; NaN where a term is not known."""
        return np.asarray(np.sqrt(sum(np.square(term) for term in self)))


def distance_sigma(
    gradient: FloatArray,
    rate_mm_per_cycle: FloatArray,
    sigma_model_phase: FloatArray,
    *,
    registration_mm2: FloatArray,
    shape_mm2: FloatArray,
    calibration_mm2: FloatArray,
    breathing_mm2: FloatArray,
    tracking_mm2: FloatArray,
) -> DistanceSigma:
    """First order: each covariance C of a place gives √(∇dᵀ C ∇d), the phase gives |∂d/∂φ| σ_φ.

    What is counted in one covariance must not come again in another: a registration whose covariance holds
    the probe's calibration gets zeros as `calibration_mm2`, which is then that of the tool's tip alone.

    Args:
        gradient: (n, 3) ∇d, model frame.
        rate_mm_per_cycle: (n,) ∂d/∂φ, the speed of the surface in model phase.
        sigma_model_phase: (n,) cycles, retiming included (`PlacesInModel.sigma_model_phase`).
        registration_mm2: (n, 3, 3) or (3, 3) of the place by the rigid pose (`PlacesInModel.covariance_mm2`).
        shape_mm2: of the surface's displacement by the change of shape.
        calibration_mm2: of the tip in the tracker, turned into the model frame.
        breathing_mm2: of the residual breathing motion.
        tracking_mm2: noise of the tool's tracked tip, turned into the model frame.
    Raises:
        InvalidInputError: shapes that do not fit.
    """
    n = len(gradient)
    check_shape(gradient, "gradient of the distance", (n, 3))
    check_shape(rate_mm_per_cycle, "rate of the distance", (n,))
    check_shape(sigma_model_phase, "sigma of the phase", (n,))

    def along_normal(covariance_mm2: FloatArray) -> FloatArray:
        if covariance_mm2.shape not in ((3, 3), (n, 3, 3)):
            raise InvalidInputError(
                f"a covariance has shape {covariance_mm2.shape}; needed (3, 3) or ({n}, 3, 3)"
            )
        each = np.broadcast_to(covariance_mm2, (n, 3, 3))
        return np.asarray(np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", gradient, each, gradient), 0.0)))

    return DistanceSigma(
        registration_mm=along_normal(registration_mm2),
        shape_mm=along_normal(shape_mm2),
        calibration_mm=along_normal(calibration_mm2),
        phase_mm=np.abs(rate_mm_per_cycle) * sigma_model_phase,
        breathing_mm=along_normal(breathing_mm2),
        tracking_mm=along_normal(tracking_mm2),
    )


def isotropic(sigma_mm: float) -> FloatArray:
    """(3, 3) mm² of noise alike in all directions.

    Raises:
        InvalidInputError: a negative or non-finite standard deviation.
    """
    if not (math.isfinite(sigma_mm) and sigma_mm >= 0.0):
        raise InvalidInputError(f"standard deviation is {sigma_mm:g} mm; it must be finite, not negative")
    return np.eye(3) * sigma_mm**2
