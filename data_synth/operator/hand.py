"""Pieces of hand motion shared by probe and tool: paths in space, changes of frame, tremor."""

from collections.abc import Callable

import numpy as np

from data_synth.signals.smooth_noise import smooth_noise
from data_synth.signals.tracker import PosePath
from dvf_ig.core import FloatArray, Rigid

TREMOR_HZ = (8.0, 12.0)
TREMOR_RMS_MM = 0.05
"""RMS of the tremor's 3-D displacement (docs/theory/synthetic.md)."""


def tremor(rng: np.random.Generator) -> Callable[[FloatArray], FloatArray]:
    """Draw physiological tremor: a function from times (n,) to displacement (n, 3) mm."""
    noise = smooth_noise(3, *TREMOR_HZ, rng)

    def displacement(t_s: FloatArray) -> FloatArray:
        return np.asarray(noise(t_s) * (TREMOR_RMS_MM / np.sqrt(3)))

    return displacement


def reframed(path: PosePath, left: Rigid, right: Rigid) -> PosePath:
    """Compose a path with fixed transforms: left @ path(t) @ right."""

    def moved(t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        rotations, translations = path(t_s)
        turned = left.rotation @ rotations
        shifted = translations @ left.rotation.T + left.translation_mm
        return turned @ right.rotation, shifted + turned @ right.translation_mm

    return moved


def minimum_jerk(u: FloatArray) -> FloatArray:
    """Compute the minimum-jerk profile from 0 to 1 for u in [0, 1]; slope <= 1.875 (Flash and Hogan 1985)."""
    v = np.clip(u, 0.0, 1.0)
    return np.asarray(v**3 * (10.0 - 15.0 * v + 6.0 * v**2))


def perpendicular(axis: FloatArray, hint: FloatArray) -> FloatArray:
    """Compute the unit vector perpendicular to the unit `axis`, as close to `hint` as possible."""
    across = hint - axis * (axis @ hint)
    length = float(np.linalg.norm(across))
    if length < 1e-6:
        return perpendicular(axis, np.roll(hint, 1) + np.array([0.0, 0.0, 1e-3]))
    return np.asarray(across / length)
