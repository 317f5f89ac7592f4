"""Faults of motion: a tool that leaves the model, a patient who moves, a registration that is off."""

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.study.faults.known_ultrasound import Coordinates
from dvf_ig.study.faults.streams import TipPath, circling

from .fault import PatientChange, TipChange, When

BOX_MM = 40.0
"""Half the edge of the wall's model."""
LEAVING_MM_S = 30.0
"""Speed of a tip that leaves the model's box."""


def leaving(beyond_mm: float) -> TipChange:
    """The tip crosses the border of the model's box as the fault begins, and again as it ends."""

    def change(when: When) -> TipPath:
        over_s = min(beyond_mm / LEAVING_MM_S, 0.5 * (when.end_s - when.begin_s))
        far = BOX_MM + LEAVING_MM_S * over_s
        from_s = BOX_MM / LEAVING_MM_S
        knots_s = [
            when.begin_s - from_s,
            when.begin_s + over_s,
            when.end_s - over_s,
            when.end_s + from_s,
        ]

        def tip(t_s: FloatArray) -> FloatArray:
            at = circling(t_s)
            at[:, 1] = np.interp(t_s, knots_s, [0.0, far, far, 0.0])
            return at

        return tip

    return change


def moved_by(by_mm: float) -> PatientChange:
    """The patient moves within half a second and stays there."""
    return lambda when, rng: _shifted(by_mm, when.begin_s, 0.5, rng)


def registered_off(by_mm: float) -> PatientChange:
    """Registrations that are asked for meanwhile put the heart elsewhere; it did not move."""

    def change(when: When, rng: np.random.Generator) -> Coordinates:
        away = by_mm * _direction(rng)
        return lambda t_s: away if when.begin_s <= t_s < when.end_s else np.zeros(6)

    return change


def _shifted(by_mm: float, begin_s: float, over_s: float, rng: np.random.Generator) -> Coordinates:
    away = by_mm * _direction(rng)
    return lambda t_s: away * min(1.0, max(0.0, (t_s - begin_s) / over_s))


def _direction(rng: np.random.Generator) -> FloatArray:
    """A unit translation in the coordinates of a pose."""
    v = rng.standard_normal(3)
    return np.concatenate([np.zeros(3), v / np.linalg.norm(v)])
