"""Contraction of the synthetic heart over the cycle, and the tabulated inverse of its motion."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from data_synth.kernels import gridded_motion
from dvf_ig.core import FloatArray, IntArray, InvalidInputError, read_only_arrays

MotionPreset = Literal["paper5mm", "physiological"]

PRESET_SCALE: dict[str, float] = {"physiological": 1.0, "paper5mm": 0.35}
"""Factor on the activation: largest epicardial motion 13.9 mm and 4.96 mm."""

ES_FRACTION = 0.36
"""Peak of the activation curve, as a fraction of the cycle."""

_TIMES = (0, 0.08, 0.16, 0.20, 0.28, 0.36, 0.40, 0.48, 0.52, 0.56, 0.60, 0.64, 0.72, 0.84, 0.88, 0.92, 0.96)
_LEVELS = (0, 0.21, 0.52, 0.66, 0.92, 1, 0.94, 0.84, 0.68, 0.54, 0.38, 0.31, 0.27, 0.29, 0.22, 0.07, 0)


@lru_cache(maxsize=1)
def _activation_curve() -> PchipInterpolator:
    times, levels = np.array(_TIMES, dtype=np.float64), np.array(_LEVELS, dtype=np.float64)
    # SciPy's PCHIP is not periodic: a padded period on each side makes slopes agree at the wrap
    return PchipInterpolator(
        np.concatenate([times - 1, times, times + 1]), np.concatenate([levels, levels, levels])
    )


def activation(model_phase: FloatArray | float) -> FloatArray:
    """Evaluate activation 0…1 of the ventricles (cyclic), as measured on a real left ventricle."""
    return np.asarray(_activation_curve()(np.asarray(model_phase, dtype=np.float64) % 1.0))


def preset_scale(motion: str) -> float:
    """Return the factor on the activation for a named motion.

    Raises:
        InvalidInputError: unknown name.
    """
    if motion not in PRESET_SCALE:
        raise InvalidInputError(f"motion '{motion}' is not known; choose one of {', '.join(PRESET_SCALE)}")
    return PRESET_SCALE[motion]


@dataclass(frozen=True, slots=True)
class MotionChange:
    """Change of the heart's motion since the MR.

    Attributes:
        contraction: factor on the activation.
        still_mm: distance from the middle of a region of the free wall, which stands still, at which the wall
            moves as elsewhere; 0: no such region.
    """

    contraction: float = 1.0
    still_mm: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.contraction <= 1.3 or not (self.still_mm == 0 or 45.0 <= self.still_mm <= 80.0):
            raise InvalidInputError(
                f"contraction is {self.contraction:g} and the still region's radius {self.still_mm:g} mm; "
                "needed 0 to 1.3, and 0 or 45 to 80 mm (a smaller region would fold space)"
            )


UNCHANGED_MOTION = MotionChange()


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class StillRegion:
    """Region of the heart that takes part in the motion by 1 − (1 − r²/R²)³ at distance r from its middle.

    Attributes:
        center_mm: (3,) middle at end-diastole, in the standard heart of frame "mr".
        radius_mm: R.
    """

    center_mm: FloatArray
    radius_mm: float

    def moving_share(self, standard_mm: FloatArray) -> FloatArray:
        """Compute the (n,) factor on the activation at (n, 3) points of the standard heart."""
        apart = ((standard_mm - self.center_mm) ** 2).sum(axis=1) / self.radius_mm**2
        return np.asarray(1.0 - np.maximum(1.0 - apart, 0.0) ** 3)


class PullBack(Protocol):
    """Map from current positions to those at end-diastole, the only part of a motion that imaging needs."""

    def pull_back(self, xyz_mm: FloatArray, model_phase: FloatArray | float) -> FloatArray:
        """Return (n, 3) reference positions X = χ⁻¹(x), at one phase or each at its own (n,)."""


class HeartMotion(PullBack, Protocol):
    """Motion χ and its inverse, frame "mr", at one phase for all points or one for each."""

    def push_forward(self, xyz_mm: FloatArray, model_phase: FloatArray | float) -> FloatArray:
        """Compute (n, 3) positions of (n, 3) end-diastolic points."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class InverseMotion:
    """Inverse motion χ⁻¹ tabulated on a grid: X = x + displacement(x, knot), linear in space and knots.

    As exact as the grid is fine if the motion is smooth; creases (the walls of a heart) are rounded off by
    some tenths of a millimetre, where `PhantomMotion` and `SurfaceMotion` are exact.

    Attributes:
        displacement_mm: (k, nx, ny, nz, 3) float32, frame "mr"; knots lie at i/k of the cycle.
        origin_mm: (3,) first node.
        spacing_mm: node pitch, the same along each axis.
    """

    displacement_mm: NDArray[np.float32]
    origin_mm: FloatArray
    spacing_mm: float

    def knots(self, model_phase: FloatArray | float, count: int) -> tuple[IntArray, IntArray, FloatArray]:
        """Find neighbouring knots and the second's weight, (count,) each, at one phase or at (count,)."""
        phase = np.array(np.broadcast_to(model_phase, (count,)), dtype=np.float64) % 1.0
        position = phase * len(self.displacement_mm)
        first = np.minimum(position.astype(np.int64), len(self.displacement_mm) - 1)
        return first, (first + 1) % len(self.displacement_mm), position - first

    def pull_back(self, xyz_mm: FloatArray, model_phase: FloatArray | float) -> FloatArray:
        """Return (n, 3) reference positions of points, at one phase or each at its own (n,)."""
        points = np.ascontiguousarray(xyz_mm, dtype=np.float64)
        out = np.empty_like(points)
        gridded_motion.pull_back(
            points,
            self.displacement_mm,
            self.origin_mm,
            1.0 / self.spacing_mm,
            *self.knots(model_phase, len(points)),
            out,
        )
        return out
