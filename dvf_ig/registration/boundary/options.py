"""Scales, steps and the offset's prior of a boundary fit."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BoundaryFitOptions:
    """How boundary points are fitted to a surface.

    Attributes:
        sigmas_mm: scales, from far to near.
        steps: at each scale but the last.
        last_steps: most at the last scale.
        free_offset_mm: the offset is free at scales up to this; 0 fixes it at the expected one.
        expected_offset_mm, offset_sigma_mm: mean and standard deviation of the offset before the fit.
        cap_mm: longest step.
        tolerance_mm: a step shorter than this ends the last scale; ten times as long a one ends the others.
    """

    sigmas_mm: tuple[float, ...] = (12.0, 8.0, 5.5, 4.0, 2.8, 2.0)
    steps: int = 8
    last_steps: int = 12
    free_offset_mm: float = 4.0
    expected_offset_mm: float = 0.0
    offset_sigma_mm: float = 1.0
    cap_mm: float = 8.0
    tolerance_mm: float = 0.02


EPICARDIUM_FIT = BoundaryFitOptions(free_offset_mm=12.0, expected_offset_mm=-4.0, offset_sigma_mm=3.0)
"""For the surface of a fixture model. Ultrasound shows the pericardium there, which lies outside of the
epicardium by the fat between them (5.5 mm on tuning seeds 101–103): the offset is free from the start."""
