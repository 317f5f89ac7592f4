"""Breathing as a separate translation of the whole heart; at rest (no displacement) at end-expiration."""

from collections.abc import Callable

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError

Breathing = Callable[[FloatArray], FloatArray]
"""Function from times (n,) s to displacements (n, 3) mm in frame "mr"."""

SHARPNESS = 2
DIRECTION = np.array([0.0, -0.29, -0.957])
"""Unit direction towards end-inspiration in LPS: down, and a little forward."""


def respiration_mm(t_s: FloatArray, excursion_mm: float, per_minute: float, phase: float = 0.0) -> FloatArray:
    """Compute (n,) mm from end-expiration at (n,) s: A cos⁴(π (f t + phase)), longest near end-expiration.

    Args:
        excursion_mm: A, from end-expiration to end-inspiration.
        per_minute: breaths a minute.
        phase: fraction of a breath, 0: end-inspiration at t = 0.
    Source: Lujan 1999, with exponent 2n = 4.
    """
    turns = np.asarray(t_s, dtype=np.float64) * per_minute / 60.0 + phase
    return np.asarray(excursion_mm * np.cos(np.pi * turns) ** (2 * SHARPNESS))


def breathing(excursion_mm: float, per_minute: float, rng: np.random.Generator) -> Breathing:
    """Draw steady breathing from a random phase; an excursion of 0 (high-frequency ventilation) is none.

    Raises:
        InvalidInputError: negative excursion, or a rate that is not positive.
    """
    if not (excursion_mm >= 0.0 and per_minute > 0.0):
        raise InvalidInputError(
            f"breathing is {excursion_mm:g} mm, {per_minute:g} a minute; needed 0 or more mm, a positive rate"
        )
    phase = float(rng.uniform())

    def displacement(t_s: FloatArray) -> FloatArray:
        return np.asarray(np.multiply.outer(respiration_mm(t_s, excursion_mm, per_minute, phase), DIRECTION))

    return displacement
