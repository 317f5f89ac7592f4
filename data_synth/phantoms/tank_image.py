"""B-mode images of wires and walls in water: the probe's beam, receiver and display, without any tissue."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_synth.ultrasound.beam import receive_gain
from data_synth.ultrasound.probe import FWHM_PER_SIGMA, SectorProbe
from data_synth.ultrasound.scan_conversion import ScanConverter
from dvf_ig.core import FloatArray, Rigid, Wire, read_only_arrays

PIECE_MM = 0.4
"""Length of the pieces of wire that echo independently: nylon is rough."""

WIRE_DB = -4.0
"""Echo of a piece of wire in the middle of the beam, relative to myocardium."""

WALL_DB = 6.0
"""Echo of a facing wall relative to myocardium; `WALL_ROUGHNESS` of its amplitude returns in all
directions."""

WALL_ROUGHNESS = 0.12
WALL_LINES = 8
"""Reflecting patches of a wall for each scan line."""

_REACH = 3.0


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Echoes:
    """Point reflectors in frame "plane": (n, 3) mm and (n,) complex amplitude relative to myocardium."""

    xyz_mm: FloatArray
    amplitude: NDArray[np.complex128]


def wire_echoes(wires: Sequence[Wire], plane_from_phantom: Rigid, probe: SectorProbe, seed: int) -> Echoes:
    """Compute echoes of the parts of straight wires within the thickness of the beam.

    Args:
        seed: seed of the wires' roughness; the same in every image of one phantom.
    """
    points, amplitudes = [], []
    for number, wire in enumerate(wires):
        length = float(np.linalg.norm(wire.back_mm - wire.front_mm))
        pieces = int(np.ceil(length / PIECE_MM))
        share = (np.arange(pieces) + 0.5)[:, None] / pieces
        xyz = plane_from_phantom.apply_array((1 - share) * wire.front_mm + share * wire.back_mm)
        rough = np.random.default_rng([seed, number]).standard_normal((pieces, 2)) @ (1.0, 1.0j)
        amplitude = 10 ** (WIRE_DB / 20) * (0.7 + 0.5 * rough)
        # the two-way elevation beam
        sigma = probe.elevation_fwhm_mm(np.maximum(xyz[:, 1], 1.0)) / FWHM_PER_SIGMA
        amplitude *= np.exp(-0.5 * (xyz[:, 2] / sigma) ** 2)
        near = np.abs(xyz[:, 2]) < _REACH * sigma
        points.append(xyz[near])
        amplitudes.append(amplitude[near])
    return Echoes(np.concatenate(points), np.concatenate(amplitudes))


def wall_echoes(normal: FloatArray, offset_mm: float, probe: SectorProbe, rng: np.random.Generator) -> Echoes:
    """Compute echoes of a flat wall normal·x = offset (frame "plane") as small patches in the image plane.
    Patches facing the beam add in phase, others cancel: a wall is visible at right angles to the lines, and
    elsewhere only by its roughness.
        lines, and elsewhere only by its roughness.
    """
    fine = np.linspace(-1.0, 1.0, probe.lines * WALL_LINES) * probe.half_angle_rad
    beams = np.column_stack([np.sin(fine), np.cos(fine), np.zeros(len(fine))])
    slope = beams @ normal
    reach = np.divide(offset_mm, slope, out=np.full(len(fine), np.inf), where=np.abs(slope) > 0.05)
    hit = (reach > 1.0) & (reach < probe.depth_mm * 1.05)
    reach, beams = reach[hit], beams[hit]
    facing = np.abs(slope[hit]) ** probe.specular_power
    arc = 2.0 * probe.half_angle_rad / len(fine) * reach
    rough = rng.standard_normal((len(reach), 2)) @ (1.0, 1.0j) / np.sqrt(2.0)
    per_patch = arc / probe.lateral_fwhm_mm(reach)
    smooth = facing * per_patch
    diffuse = WALL_ROUGHNESS * rough * np.sqrt(per_patch)
    return Echoes(beams * reach[:, None], 10 ** (WALL_DB / 20) * (smooth + diffuse))


def water_images(probe: SectorProbe, frames: Sequence[Echoes], seed: int) -> NDArray[np.uint8]:
    """Simulate (n, rows, columns) images of each frame's echoes in clear water; `seed`: receiver noise."""
    converter = ScanConverter.of(probe.polar, probe.pixels)
    gain = receive_gain(probe)
    out = np.empty((len(frames), probe.rows, probe.columns), dtype=np.uint8)
    for i, echoes in enumerate(frames):
        signal = _beams(probe, echoes)
        noise = np.random.default_rng([seed, i]).standard_normal((2, *signal.shape)) / np.sqrt(2.0)
        signal += 10 ** (probe.noise_db / 20) * (noise[0] + 1j * noise[1])
        level_db = 20 * np.log10(np.abs(signal) * gain + 1e-10)
        floor_db = probe.top_db - probe.dynamic_range_db
        grey = np.clip((level_db - floor_db) * (255.0 / probe.dynamic_range_db), 0, 255)
        out[i] = converter(grey.astype(np.float32))
    return out


def _beams(probe: SectorProbe, echoes: Echoes) -> NDArray[np.complex128]:
    """Compute the (lines, samples) signal: each reflector spread by the two-way beam and the pulse."""
    x, y, z = echoes.xyz_mm.T
    across, distance = np.hypot(x, y), np.sqrt(x**2 + y**2 + z**2)
    pitch = 2.0 * probe.half_angle_rad / (probe.lines - 1)
    line = (np.arctan2(x, y) + probe.half_angle_rad) / pitch
    depth = distance - probe.face_radius_mm
    sample = depth / probe.step_mm - 0.5
    wide = probe.lateral_fwhm_mm(np.maximum(depth, 1.0)) / FWHM_PER_SIGMA / across / pitch
    long = probe.axial_fwhm_mm / FWHM_PER_SIGMA / probe.step_mm
    turns = np.exp(-4j * np.pi * distance / probe.wavelength_mm)
    reach = (int(np.ceil(_REACH * wide.max(initial=1.0))), int(np.ceil(_REACH * long)))
    lines = np.round(line).astype(int)[:, None] + np.arange(-reach[0], reach[0] + 1)
    samples = np.round(sample).astype(int)[:, None] + np.arange(-reach[1], reach[1] + 1)
    beam = np.exp(-0.5 * ((lines - line[:, None]) / wide[:, None]) ** 2)
    pulse = np.exp(-0.5 * ((samples - sample[:, None]) / long) ** 2)
    patch = (echoes.amplitude * turns)[:, None, None] * beam[:, :, None] * pulse[:, None, :]
    # a margin receives what is outside, so that no reflector needs clipping
    top, left = reach[1] + 1, reach[0] + 1
    keep = (lines[:, 0] >= -left) & (lines[:, -1] < probe.lines + left)
    keep &= (samples[:, 0] >= -top) & (samples[:, -1] < probe.samples + top)
    out = np.zeros((probe.lines + 2 * left, probe.samples + 2 * top), dtype=np.complex128)
    np.add.at(out, (lines[keep][:, :, None] + left, samples[keep][:, None, :] + top), patch[keep])
    return out[left:-left, top:-top]
