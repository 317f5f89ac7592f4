"""Point spread function of a scan as filter weights, scaled so that speckle keeps its power."""

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray

from .probe import FWHM_PER_SIGMA, SectorProbe

LATTICE_MM = 0.15
"""Pitch of the scatterer lattice: a third of the default pulse's axial width."""

ELEVATION_REACH = 2.0
"""Distance of the outermost elevation planes from the middle one, in standard deviations."""

NARROWEST_LINES = 0.02
"""Smallest standard deviation of a beam, in fine lines: at a curved array's face it would be 0."""


def lattice_correlation(distance_mm: FloatArray) -> FloatArray:
    """Compute the chance that two points are in the same lattice cell, averaged over directions."""
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(64)
    height = 1 - (np.arange(64) + 0.5) / 32
    ring = np.sqrt(1 - height**2)
    directions = np.abs(np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height]))
    share = 1 - np.asarray(distance_mm)[..., None, None] * directions / LATTICE_MM
    return np.asarray(np.maximum(share, 0.0).prod(axis=-1).mean(axis=-1))


def axial_taps(fwhm_mm: float, step_mm: float) -> NDArray[np.float32]:
    """Compute an even number of Gaussian weights on the half-step raster.

    Scaled so that scatterers of unit power give unit power, although neighbours share lattice cells.
    """
    half_mm = 0.5 * step_mm
    sigma = fwhm_mm / FWHM_PER_SIGMA / half_mm
    reach = int(np.ceil(3 * sigma))
    weights = np.exp(-0.5 * ((np.arange(2 * reach) - reach + 0.5) / sigma) ** 2)
    power = (weights**2).sum()
    for lag in range(1, 2 * reach):
        power += 2 * lattice_correlation(np.array(lag * half_mm)) * (weights[lag:] * weights[:-lag]).sum()
    return np.asarray(weights / np.sqrt(power), dtype=np.float32)


def lateral_taps(fwhm_rad: FloatArray, pitch_rad: float, radius_mm: FloatArray) -> NDArray[np.float32]:
    """Compute (k, samples) Gaussian weights over fine lines at each depth; k is even.

    Scaled so that scatterers of unit power give unit power at every depth, although neighbouring fine lines
    share lattice cells near the probe.

    Args:
        fwhm_rad: (samples,) angular width of the beam at each depth.
        pitch_rad: angle between fine lines.
        radius_mm: (samples,) distance of the samples from the fan apex.
    """
    sigma = np.maximum(fwhm_rad / FWHM_PER_SIGMA / pitch_rad, NARROWEST_LINES)
    reach = int(np.ceil(3 * sigma.max()))
    offset = (np.arange(2 * reach) - reach + 0.5)[:, None]
    weights = np.exp(-0.5 * (offset / sigma) ** 2)
    power = (weights**2).sum(axis=0)
    for lag in range(1, 2 * reach):
        distance = lag * pitch_rad * radius_mm
        near = np.flatnonzero(distance < np.sqrt(3) * LATTICE_MM)
        shared = lattice_correlation(distance[near])
        power[near] += 2 * shared * (weights[lag:, near] * weights[:-lag, near]).sum(axis=0)
    return np.asarray(weights / np.sqrt(power), dtype=np.float32)


def elevation_offsets(probe: SectorProbe) -> FloatArray:
    """Compute (planes,) distances of elevation planes from the middle one, in SDs of the beam."""
    if probe.elevation_planes == 1:
        return np.zeros(1)
    return np.linspace(-ELEVATION_REACH, ELEVATION_REACH, probe.elevation_planes)


def elevation_weights(probe: SectorProbe) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Compute (planes, samples) weights of scatterers, added in power, and interfaces, added in phase."""
    offsets = elevation_offsets(probe)
    sigma_mm = probe.elevation_fwhm_mm(probe.depths_mm) / FWHM_PER_SIGMA
    weights = np.exp(-0.5 * offsets**2)
    power = np.full(probe.samples, (weights**2).sum())
    for i in range(len(offsets)):
        for j in range(i):
            shared = lattice_correlation((offsets[i] - offsets[j]) * sigma_mm)
            power += 2 * shared * weights[i] * weights[j]
    interface = np.repeat((weights / weights.sum())[:, None], probe.samples, axis=1)
    return (weights[:, None] / np.sqrt(power)).astype(np.float32), interface.astype(np.float32)


def receive_gain(probe: SectorProbe) -> NDArray[np.float32]:
    """Compute (samples,) time-gain compensation as an amplitude factor."""
    decibel = 2 * probe.tgc_db_per_cm_mhz * probe.frequency_mhz * probe.depths_mm / 10
    return np.asarray(10 ** (decibel / 20), dtype=np.float32)


def haze(probe: SectorProbe) -> NDArray[np.float32]:
    """Compute the (samples,) amplitude of near-field clutter, decaying exponentially from the face."""
    level = 10 ** (probe.haze_db / 20) * np.exp(-probe.depths_mm / probe.haze_mm)
    return np.asarray(level, dtype=np.float32)
