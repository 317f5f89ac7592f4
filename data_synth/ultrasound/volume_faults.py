"""Faults of `image_faults` in 3-D: clutter adds power to a pyramid of scan lines, shadows remove it."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from dvf_ig.core import FloatArray

from .image_faults import CLUTTER_DB, CLUTTER_DECAY_MM, SHADOW_ONSET_MM, ImageSpec
from .probe import FWHM_PER_SIGMA
from .volume import MatrixProbe


def degraded_pyramid(
    level_db: NDArray[np.float32], probe: MatrixProbe, spec: ImageSpec, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Add clutter and shadows to (tall, lines, samples) dB; unchanged without any.

    Args:
        level_db: echo level of `simulate_pyramid`.
        spec: faults; its dynamic range belongs to the display and has no effect here.
    """
    if spec.clutter == 0 and spec.shadows == 0:
        return level_db
    out = level_db - _shadow_db(probe, spec, rng)
    power = 10 ** (out / 10) + _clutter_power(level_db.shape, probe, spec, rng)
    return np.asarray(10 * np.log10(power), dtype=np.float32)


def _shadow_db(probe: MatrixProbe, spec: ImageSpec, rng: np.random.Generator) -> FloatArray:
    """Draw the loss behind ribs or lost contact at the probe's face, each a cone of lines."""
    half, s = probe.sector.half_angle_rad, probe.sector
    across, up = np.meshgrid(s.line_angles_rad, np.linspace(-half, half, probe.tall))
    width = np.deg2rad(spec.shadow_deg) / FWHM_PER_SIGMA
    share = np.zeros_like(across)
    for _ in range(spec.shadows):
        x, y = rng.uniform(-half, half, 2)
        # a rib is long: the shadow stretches four times as far in one direction
        turn = rng.uniform(0, np.pi)
        along = np.cos(turn) * (across - x) + np.sin(turn) * (up - y)
        beside = -np.sin(turn) * (across - x) + np.cos(turn) * (up - y)
        share = np.maximum(share, np.exp(-0.5 * ((beside / width) ** 2 + (along / (4 * width)) ** 2)))
    ramp = spec.shadow_db * (1.0 - np.exp(-((s.depths_mm / SHADOW_ONSET_MM) ** 2)))
    return np.asarray(share[:, :, None] * ramp)


def _clutter_power(
    shape: tuple[int, ...], probe: MatrixProbe, spec: ImageSpec, rng: np.random.Generator
) -> FloatArray:
    s = probe.sector
    sigma = (1.2, 1.2, s.axial_fwhm_mm / FWHM_PER_SIGMA / s.step_mm)
    parts = [gaussian_filter(rng.standard_normal(shape), sigma) for _ in range(2)]
    speckle = parts[0] ** 2 + parts[1] ** 2
    amplitude = spec.clutter * 10 ** (CLUTTER_DB / 20) * np.exp(-s.depths_mm / CLUTTER_DECAY_MM)
    return np.asarray(speckle / speckle.mean() * amplitude**2)
