"""Degradation of ultrasound images beyond the physics of tissue: clutter, shadows, low dynamic range.

Applied to compressed images, whose grey is a linear scale of decibels: shadows subtract from it, and clutter
adds as power.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from data_synth.signals.smooth_noise import smooth_noise
from dvf_ig.core import FloatArray, InvalidInputError

from .probe import FWHM_PER_SIGMA, SectorProbe
from .volume import MatrixProbe

CLUTTER_DB = -24.0
"""Ordinary clutter near the probe, relative to myocardium (Lediju 2009 measured 0 to −50 dB in vivo)."""

CLUTTER_DECAY_MM = 80.0
"""Depth over which the amplitude of clutter falls to 1/e: reverberation of the chest wall dies out."""

SHADOW_ONSET_MM = 12.0


@dataclass(frozen=True, slots=True)
class ImageSpec:
    """Faults of the images.

    Attributes:
        clutter: amplitude of the clutter as a multiple of CLUTTER_DB; 0 is none. It is fixed in the
            image while the heart moves behind it.
        shadows: number of shadows (ribs, lost contact); they wander slowly through the sector.
        shadow_deg: full width of a shadow at half its loss.
        shadow_db: two-way loss in its middle.
        dynamic_range_db: dynamic range of the log compression, at most the probe's own.
    """

    clutter: float = 0.0
    shadows: int = 0
    shadow_deg: float = 9.0
    shadow_db: float = 28.0
    dynamic_range_db: float = 60.0

    def __post_init__(self) -> None:
        if min(self.clutter, self.shadows, self.shadow_db) < 0 or not 0 < self.shadow_deg <= 90:
            raise InvalidInputError(
                "an image fault is negative, or shadows are not 0 to 90° wide; needed 0 or more"
            )
        if not 10.0 <= self.dynamic_range_db <= 120.0:
            raise InvalidInputError(f"dynamic range is {self.dynamic_range_db:g} dB; needed 10 to 120 dB")


def degraded(
    images: NDArray[np.uint8], probe: SectorProbe, t_s: FloatArray, spec: ImageSpec, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Add the faults of `spec` to (n, rows, columns) images; without any, return them unchanged.

    Args:
        t_s: (n,) times of the images.
    """
    narrow = spec.dynamic_range_db < probe.dynamic_range_db
    if spec.clutter == 0 and spec.shadows == 0 and not narrow:
        return images
    line, sample = probe.pixel_lookup()
    seen = line >= 0
    depth_mm = np.asarray((sample[seen] + 0.5) * probe.step_mm, dtype=np.float64)
    angle = np.interp(line[seen], np.arange(probe.lines), probe.line_angles_rad)
    shadow_db = _shadows(angle, depth_mm, probe, t_s, spec, rng)
    clutter = _clutter(line[seen], sample[seen], probe, spec, rng)
    mixing = np.pi * smooth_noise(1, 0.1, 0.6, rng)(t_s)[:, 0]
    range_db = min(spec.dynamic_range_db, probe.dynamic_range_db)
    out = np.zeros_like(images)
    for i, image in enumerate(images):
        other = np.abs(clutter[0] * np.cos(mixing[i]) + clutter[1] * np.sin(mixing[i])) ** 2
        out[i][seen] = with_echoes(image[seen], probe, shadow_db(i), other, range_db)
    return out


def with_echoes(
    grey: NDArray[np.uint8], probe: SectorProbe, loss_db: FloatArray, power: FloatArray, range_db: float
) -> FloatArray:
    """Compute (n,) grey levels 0 to 255 of pixels after a loss, with the power of other echoes added.

    Args:
        grey: (n,) grey levels of the probe.
        loss_db: (n,) loss of these; power: (n,) relative to myocardium's scatter, which is not lost.
        range_db: dynamic range of the result.
    """
    shown = grey.astype(np.float64)
    level = probe.top_db - probe.dynamic_range_db + shown * (probe.dynamic_range_db / 255.0) - loss_db
    total = np.where(shown > 0, 10 ** (level / 10), 0.0) + power
    level = 10 * np.log10(total + 1e-12)
    return np.asarray(np.clip((level - probe.top_db + range_db) * (255.0 / range_db) + 0.5, 0, 255))


def _shadows(
    angle: FloatArray,
    depth_mm: FloatArray,
    probe: SectorProbe,
    t_s: FloatArray,
    spec: ImageSpec,
    rng: np.random.Generator,
) -> Callable[[int], FloatArray]:
    """Draw the loss in dB at every pixel by image number: wandering shadows spread over the sector."""
    count = spec.shadows
    spread = (np.arange(count) + rng.uniform(0.2, 0.8, count)) / max(count, 1)
    wander = smooth_noise(max(count, 1), 0.02, 0.15, rng)(t_s)[:, :count]
    centers = probe.half_angle_rad * (2.0 * spread - 1.0) + np.deg2rad(0.7 * spec.shadow_deg) * wander
    ramp = spec.shadow_db * (1.0 - np.exp(-((depth_mm / SHADOW_ONSET_MM) ** 2)))
    width = np.deg2rad(spec.shadow_deg) / FWHM_PER_SIGMA

    def loss_db(frame: int) -> FloatArray:
        share = np.zeros_like(angle)
        for center in centers[frame]:
            np.maximum(share, np.exp(-0.5 * ((angle - center) / width) ** 2), out=share)
        return np.asarray(share * ramp)

    return loss_db


def _clutter(
    line: NDArray[np.float32],
    sample: NDArray[np.float32],
    probe: SectorProbe,
    spec: ImageSpec,
    rng: np.random.Generator,
) -> NDArray[np.complex128]:
    """Draw the (2, pixels) complex amplitude of two independent clutter fields, speckled like echoes."""
    sigma = (1.2, probe.axial_fwhm_mm / FWHM_PER_SIGMA / probe.step_mm)
    at = np.stack([line, sample])
    depth_mm = (sample + 0.5) * probe.step_mm
    level = spec.clutter * 10 ** (CLUTTER_DB / 20) * np.exp(-depth_mm / CLUTTER_DECAY_MM)
    fields = []
    for _ in range(2):
        parts = [gaussian_filter(rng.standard_normal((probe.lines, probe.samples)), sigma) for _ in range(2)]
        real, imaginary = (map_coordinates(part, at, order=1) for part in parts)
        field = real + 1j * imaginary
        # interpolation removes some power; the level is that of the image
        fields.append(level * field / np.sqrt(np.mean(np.abs(field) ** 2)))
    return np.stack(fields)


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
