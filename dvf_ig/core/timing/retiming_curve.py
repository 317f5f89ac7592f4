"""Retiming of one beat: from phase in the beat to phase of the model, a monotone cubic with its slope.

With the beat's end-systole at S, the model's at E and the slopes m_R and m_S there, phase φ lies in the piece
from 0 to S or from S to 1, of width h and from model phase y₀ to y₀ + k. With u the place in the piece and
m₀, m₁ the slopes at its ends,

    y(u) = y₀ + k u²(3 − 2u) + m₀ h u(1 − u)² − m₁ h u²(1 − u)
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import InvalidInputError


class CubicPieces(NamedTuple):
    """Periodic cubic through (0, 0), (S, E), (1, 1); each field a number, or one for each beat."""

    end_systole: FloatArray | float
    model_end_systole: FloatArray | float
    slope_at_r: FloatArray | float
    slope_at_end_systole: FloatArray | float

    def at(self, phi: FloatArray) -> FloatArray:
        """Compute (...) model phase in [0, 1) at phases in [0, 1)."""
        u, width, height, first, last = self._piece(phi)
        bottom = np.where(phi <= self.end_systole, 0.0, self.model_end_systole)
        cubic = (
            bottom
            + height * u * u * (3 - 2 * u)
            + first * width * u * (1 - u) ** 2
            - last * width * u * u * (1 - u)
        )
        return np.asarray(np.clip(cubic, 0.0, np.nextafter(1.0, 0.0)))

    def slope(self, phi: FloatArray) -> FloatArray:
        """Compute the (...) derivative of `at`."""
        u, width, height, first, last = self._piece(phi)
        chord = height / width
        return np.asarray(6 * chord * u * (1 - u) + first * (1 - u) * (1 - 3 * u) - last * u * (2 - 3 * u))

    def _piece(self, phi: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Find the position in the piece, its width and height, and the slopes at its ends."""
        systole, es = self.end_systole, self.model_end_systole
        early = phi <= systole
        width = np.where(early, systole, 1.0 - systole)
        height = np.where(early, es, 1.0 - es)
        first = np.where(early, self.slope_at_r, self.slope_at_end_systole)
        last = np.where(early, self.slope_at_end_systole, self.slope_at_r)
        return np.where(early, phi, phi - systole) / width, width, height, first, last


@dataclass(frozen=True, slots=True)
class RetimingCurve:
    """Retiming of a beat of one predicted length; `dvf_ig.cardiac.retiming_curve` makes it.

    Attributes:
        end_systole: share of the beat at which its systole ends.
        model_end_systole: model phase of end-systole.
        slope_at_r, slope_at_end_systole: slopes of the curve at its knots, model cycles a beat.
    """

    end_systole: float
    model_end_systole: float
    slope_at_r: float
    slope_at_end_systole: float

    def __post_init__(self) -> None:
        if not (0.0 < self.end_systole < 1.0 and 0.0 < self.model_end_systole < 1.0):
            raise InvalidInputError(
                f"end-systole at {self.end_systole:g} of the beat and {self.model_end_systole:g} of the "
                "model's cycle; needed both between 0 and 1"
            )
        if not (self.slope_at_r >= 0.0 and self.slope_at_end_systole >= 0.0):
            raise InvalidInputError(
                f"retiming with slopes {self.slope_at_r:g} and {self.slope_at_end_systole:g}; "
                "needed both 0 or above"
            )

    @classmethod
    def uniform(cls) -> "RetimingCurve":
        """Stretch the model's cycle evenly: model phase is phase (Ren 2008, Section VII)."""
        return cls(0.5, 0.5, 1.0, 1.0)

    def at(self, phi: FloatArray | float) -> FloatArray:
        """Compute (...) model phase in [0, 1) at phase `phi`, taken modulo 1."""
        return self._pieces().at(np.asarray(phi, dtype=np.float64) % 1.0)

    def slope(self, phi: FloatArray | float) -> FloatArray:
        """Compute the (...) derivative of model phase by phase."""
        return self._pieces().slope(np.asarray(phi, dtype=np.float64) % 1.0)

    def _pieces(self) -> CubicPieces:
        return CubicPieces(
            self.end_systole, self.model_end_systole, self.slope_at_r, self.slope_at_end_systole
        )
