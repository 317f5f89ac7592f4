"""Uncertainty-aware margins: σ of the distance by cause, widened laws."""

from .distance_sigma import DistanceSigma, distance_sigma, isotropic
from .margin import MarginMode, MarginOptions, next_margin_mm, widened

__all__ = [
    "DistanceSigma",
    "MarginMode",
    "MarginOptions",
    "distance_sigma",
    "isotropic",
    "next_margin_mm",
    "widened",
]
