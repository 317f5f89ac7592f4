"""Uncertainty-aware margins: σ of the distance by cause, widened laws, walls without a phase."""

from .distance_sigma import DistanceSigma, distance_sigma, isotropic
from .margin import MarginMode, MarginOptions, next_margin_mm, widened
from .worst_phase import worst_phase_forces

__all__ = [
    "DistanceSigma",
    "MarginMode",
    "MarginOptions",
    "distance_sigma",
    "isotropic",
    "next_margin_mm",
    "widened",
    "worst_phase_forces",
]
