"""Uncertainty-aware margins: standard deviation of the distance by cause, and the laws that it widens."""

import math
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Literal, NamedTuple

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.core.arrays import check_shape

from .laws import Gaussian, Law
from .supervision.supervisor import SLOW_SLEW_N_PER_S


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
    """Isotropic covariance, (3, 3) mm².

    Raises:
        InvalidInputError: a negative or non-finite standard deviation.
    """
    if not (math.isfinite(sigma_mm) and sigma_mm >= 0.0):
        raise InvalidInputError(f"standard deviation is {sigma_mm:g} mm; it must be finite, not negative")
    return np.eye(3) * sigma_mm**2


MarginMode = Literal["off", "fixed", "adaptive"]

LARGEST_MARGIN_MM = 5.0
"""A wall further out than this closes the field of work. By judgement, on no heart."""
LARGEST_SPEED_MM_S = 10.0
"""As of a registration update (docs/theory/safety.md)."""


@dataclass(frozen=True, slots=True)
class MarginOptions:
    """How wide a margin is.

    Attributes:
        mode: "off", "fixed" or "adaptive".
        fixed_mm: of "fixed".
        quantile: of "adaptive", of a normal distribution with σ_d: 0.95 gives 1.64 σ_d.
        largest_mm: cap of both.
    Raises:
        InvalidInputError: an unknown mode, or numbers out of range.
    """

    mode: MarginMode = "off"
    fixed_mm: float = 2.0
    quantile: float = 0.95
    largest_mm: float = LARGEST_MARGIN_MM

    def __post_init__(self) -> None:
        if self.mode not in ("off", "fixed", "adaptive"):
            raise InvalidInputError(f"unknown margin '{self.mode}'; choose one of off, fixed, adaptive")
        if not (math.isfinite(self.largest_mm) and 0.0 <= self.fixed_mm <= self.largest_mm):
            raise InvalidInputError(
                f"fixed margin is {self.fixed_mm:g} mm; it must lie between 0 and the cap, "
                f"{self.largest_mm:g} mm, which must be finite"
            )
        if not 0.5 <= self.quantile < 1.0:
            raise InvalidInputError(f"quantile of the margin is {self.quantile:g}; needed 0.5 up to below 1")

    def wanted_mm(self, sigma_mm: float) -> float:
        """Margin at a σ_d; the cap where an adaptive one does not know σ_d."""
        if self.mode == "off":
            return 0.0
        if self.mode == "fixed":
            return self.fixed_mm
        if not math.isfinite(sigma_mm) or sigma_mm < 0.0:
            return self.largest_mm
        return min(NormalDist().inv_cdf(self.quantile) * sigma_mm, self.largest_mm)


NO_MARGIN = MarginOptions()


def next_margin_mm(now_mm: float, wanted_mm: float, dt_s: float, law: Law, step_n: float) -> float:
    """One update of a margin on its way to the wanted one; the wall's own motion obeys the slew rules.

    It moves by no more than 10 mm/s, no faster than changes the force by 6 N/s (the rate of a registration
    update), and in one update by no more than changes the force by `step_n`.

    Args:
        now_mm, wanted_mm: not negative.
        dt_s: since the last update.
        law: its stiffness turns mm into N.
        step_n: force that one servo tick may change: slew limit × its period.
    Raises:
        InvalidInputError: time that goes back, or numbers that are negative or not finite.
    """
    if not all(math.isfinite(x) and x >= 0.0 for x in (now_mm, wanted_mm, dt_s, step_n)):
        raise InvalidInputError(
            f"margin {now_mm:g} mm, wanted {wanted_mm:g} mm, after {dt_s:g} s, step {step_n:g} N; "
            "all must be finite, none negative"
        )
    stiffness = law.stiffness_n_per_mm
    speed = min(LARGEST_SPEED_MM_S, SLOW_SLEW_N_PER_S / stiffness)
    most = min(speed * dt_s, step_n / stiffness)
    return now_mm + min(max(wanted_mm - now_mm, -most), most)


def widened(law: Law, margin_mm: float) -> Law:
    """Widen a law by a margin: a forbidden region begins earlier by it, a guidance's δ grows by it.

    The same as `ServoInputs.margin_mm` in the servo. No law becomes stiffer.

    Raises:
        InvalidInputError: a margin that is negative or not finite.
    """
    if not (math.isfinite(margin_mm) and margin_mm >= 0.0):
        raise InvalidInputError(f"margin is {margin_mm:g} mm; it must be finite and not negative")
    if isinstance(law, Gaussian):
        return replace(law, delta_mm=law.delta_mm + margin_mm)
    return replace(law, depth_mm=law.depth_mm - margin_mm)
