"""When and how far the synthetic heart contracts, and the tabulated inverse of its motion."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from dvf_ig.core import FloatArray, IntArray, InvalidInputError

from .kernels import lookup

MotionPreset = Literal["paper5mm", "physiological"]

PRESET_SCALE: dict[str, float] = {"physiological": 1.0, "paper5mm": 0.35}
"""Factor on the activation: largest epicardial motion 13.9 mm and 4.96 mm."""

ES_FRACTION = 0.36
"""Where the activation curve peaks, as a fraction of the cycle."""

_TIMES = (0, 0.08, 0.16, 0.20, 0.28, 0.36, 0.40, 0.48, 0.52, 0.56, 0.60, 0.64, 0.72, 0.84, 0.88, 0.92, 0.96)
_LEVELS = (0, 0.21, 0.52, 0.66, 0.92, 1, 0.94, 0.84, 0.68, 0.54, 0.38, 0.31, 0.27, 0.29, 0.22, 0.07, 0)


@lru_cache(maxsize=1)
def _activation_curve() -> PchipInterpolator:
    times, levels = np.array(_TIMES, dtype=np.float64), np.array(_LEVELS, dtype=np.float64)
    # SciPy's PCHIP knows no period: a padded period on each side makes slopes agree at the wrap
    return PchipInterpolator(
        np.concatenate([times - 1, times, times + 1]), np.concatenate([levels, levels, levels])
    )


def activation(model_phase: FloatArray | float) -> FloatArray:
    """Activation 0…1 of the ventricles at a model phase (cyclic): measured on a real left ventricle."""
    return np.asarray(_activation_curve()(np.asarray(model_phase, dtype=np.float64) % 1.0))


def preset_scale(motion: str) -> float:
    """Factor on the activation for a named motion.

    Raises:
        InvalidInputError: unknown name.
    """
    if motion not in PRESET_SCALE:
        raise InvalidInputError(f"motion '{motion}' is not known; choose one of {', '.join(PRESET_SCALE)}")
    return PRESET_SCALE[motion]


@dataclass(frozen=True, slots=True, eq=False)
class InverseMotion:
    """χ⁻¹ on a grid, tabulated at knots: X = x + displacement(x, knot), trilinear in space, linear in knots.

    Attributes:
        displacement_mm: (k, nx, ny, nz, 3) float32, frame "mr".
        origin_mm: (3,) first node.
        spacing_mm: node pitch, the same along each axis.
        levels: (k,) activation of each knot, or None where knots lie at i/k of the cycle.
        scale: activation preset factor (used with `levels`).
    """

    displacement_mm: NDArray[np.float32]
    origin_mm: FloatArray
    spacing_mm: float
    levels: FloatArray | None
    scale: float = 1.0

    def bracket(self, model_phase: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
        """Neighbouring knots of each phase and the weight of the second: (n,) each."""
        phase = np.asarray(model_phase, dtype=np.float64) % 1.0
        count = len(self.displacement_mm)
        if self.levels is None:
            position = phase * count
            first = np.minimum(position.astype(np.int64), count - 1)
            return first, (first + 1) % count, position - first
        level = np.clip(activation(phase) * self.scale, self.levels[0], self.levels[-1])
        first = np.clip(np.searchsorted(self.levels, level, side="right") - 1, 0, count - 2).astype(np.int64)
        step = self.levels[first + 1] - self.levels[first]
        return first, first + 1, (level - self.levels[first]) / step

    def pull_back(self, xyz_mm: FloatArray, model_phase: float) -> FloatArray:
        """(n, 3) reference positions of points at one phase."""
        first, second, weight = self.bracket(np.array([model_phase]))
        points = np.ascontiguousarray(xyz_mm, dtype=np.float64)
        out = np.empty_like(points)
        lookup.pull_back(
            points,
            self.displacement_mm,
            self.origin_mm,
            1.0 / self.spacing_mm,
            first[0],
            second[0],
            weight[0],
            out,
        )
        return out
