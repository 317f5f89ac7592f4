"""Freehand sweep over labelled tissue, reconstructed to a volume, by physics independent of MR.

Scatterers of each tissue's echogenicity give Rayleigh speckle, borders between impedances give echoes where
the beam meets them squarely, sound is lost on the way, and behind strong borders. The point spread widens
with depth; frames are placed with tracking error, and voxels that no frame reached stay 0.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from data_synth.seeds import child_rng
from dvf_ig.core import AnyArray, FloatArray, Grid, Rigid, Volume

from .fields import sampled, smooth_field
from .organ import OrganLabels

LINE_MM, FRAME_MM = 0.5, 0.7
"""Distance of lines and of frames in the middle of the depth."""


@dataclass(frozen=True, slots=True)
class ScanStyle:
    """Parameters that vary between scanners and settings; lengths in mm, angles in degrees."""

    depth_mm: float
    sector_deg: float
    sweep_deg: float
    foot_mm: float
    step_mm: float
    axial_mm: float
    lateral_mm: float
    elevation_mm: float
    widening: float
    looks: int
    range_db: float
    gamma: float
    border_gain: float
    contrast: float
    texture_db: float
    texture_mm: float
    shadow_db: float
    floor_db: float
    gain_error_db: float
    jitter_mm: float
    lost_share: float
    voxel_mm: float


def scan_style(seed: int) -> ScanStyle:
    """Draw a scanner and its settings."""
    rng = child_rng(seed, "organ scanner")
    return ScanStyle(
        depth_mm=rng.uniform(58, 82),
        sector_deg=rng.uniform(26, 42),
        sweep_deg=rng.uniform(22, 38),
        foot_mm=rng.uniform(8, 18),
        step_mm=0.4,
        axial_mm=rng.uniform(0.2, 0.5),
        lateral_mm=rng.uniform(0.3, 0.6),
        elevation_mm=rng.uniform(0.5, 1.0),
        widening=rng.uniform(0.4, 1.4),
        looks=int(rng.integers(1, 5)),
        range_db=rng.uniform(42, 72),
        gamma=rng.uniform(0.7, 1.5),
        border_gain=rng.uniform(0.3, 1.6),
        contrast=rng.uniform(0.2, 1.0),
        texture_db=rng.uniform(1.0, 5.0),
        texture_mm=rng.uniform(6.0, 16.0),
        shadow_db=rng.choice([0.0, 1.0]) * rng.uniform(3.0, 25.0),
        floor_db=rng.uniform(-62, -48),
        gain_error_db=rng.uniform(0, 5),
        jitter_mm=rng.uniform(0.05, 0.35),
        lost_share=rng.uniform(0.0, 0.12),
        voxel_mm=rng.choice([0.4, 0.5, 0.5, 0.6]),
    )


def organ_ultrasound(
    organ: OrganLabels, shift_mm: FloatArray, moving_from_fixed: Rigid, style: ScanStyle, seed: int
) -> Volume:
    """Simulate the reconstructed volume, frame "fixed", 0 outside the insonified part.

    Args:
        shift_mm: (nx, ny, nz, 3) on the organ's grid: tissue now at x was at x + shift in the MR images.
        moving_from_fixed: pose of the ultrasound's frame.
    """
    moving_from_probe = _probe(organ, seed)
    swept = _swept(style)
    xyz = moving_from_probe.apply_array(_places(swept, style))
    displaced = xyz + np.stack([sampled(shift_mm[..., k], organ.grid, xyz) for k in range(3)], axis=-1)
    grey = _images(organ, displaced, style, child_rng(seed, "organ speckle"))
    fixed_from_probe = moving_from_fixed.inverse() @ moving_from_probe
    return _reconstructed(grey, swept, style, fixed_from_probe, child_rng(seed, "organ tracking"))


def _probe(organ: OrganLabels, seed: int) -> Rigid:
    """Build moving_from_probe: z into the organ, y along the sweep."""
    rng = child_rng(seed, "organ probe")
    z = organ.inward + 0.12 * rng.normal(size=3)
    z /= np.linalg.norm(z)
    x = np.cross(rng.normal(size=3), z)
    if organ.across is not None:
        x = organ.across - (organ.across @ z) * z
    x /= np.linalg.norm(x)
    return Rigid("moving", "probe", np.column_stack([x, np.cross(z, x), z]), organ.entry_mm - 1.5 * z)


def _swept(style: ScanStyle) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return angles of lines, angles of frames, and depths: the axes of the insonified part."""
    middle = style.foot_mm + 0.6 * style.depth_mm
    lines = np.radians(style.sector_deg) * np.linspace(
        -1, 1, int(2 * np.radians(style.sector_deg) * middle / LINE_MM)
    )
    frames = np.radians(style.sweep_deg) * np.linspace(
        -1, 1, int(2 * np.radians(style.sweep_deg) * middle / FRAME_MM)
    )
    return lines, frames, np.arange(2.0, style.depth_mm, style.step_mm)


def _places(swept: tuple[FloatArray, FloatArray, FloatArray], style: ScanStyle) -> FloatArray:
    """Compute (lines, frames, depths, 3) mm in the probe's frame: a curved array tilted about its foot."""
    line, frame, r = np.meshgrid(*swept, indexing="ij")
    x, away = (style.foot_mm + r) * np.sin(line), (style.foot_mm + r) * np.cos(line)
    return np.stack([x, away * np.sin(frame), away * np.cos(frame) - style.foot_mm], axis=-1)


def _images(organ: OrganLabels, xyz_mm: FloatArray, style: ScanStyle, rng: np.random.Generator) -> AnyArray:
    """Simulate (lines, frames, depths) grey levels, 1 to 255."""
    sound = organ.acoustics
    echo_db = np.array(sound.echo_db) + rng.normal(0, 2.5, len(sound.echo_db)).clip(-5, 5)
    echo_db = echo_db[1] + style.contrast * (echo_db - echo_db[1])
    textured = echo_db[organ.labels] + style.texture_db * smooth_field(organ.grid, style.texture_mm, rng)
    level_db = sampled(textured.astype(np.float32), organ.grid, xyz_mm)
    loss = sampled(np.array(sound.loss_db_per_mm, dtype=np.float32)[organ.labels], organ.grid, xyz_mm)
    impedance = np.log(np.array(sound.impedance) * (1 + rng.normal(0, 0.006, len(sound.impedance))))
    stiff = sampled(impedance[organ.labels].astype(np.float32), organ.grid, xyz_mm)
    border = np.abs(np.gradient(stiff, axis=-1)) * 120.0 * style.border_gain
    lost_db = 2 * np.cumsum(loss * style.step_mm, axis=-1) + 60.0 * np.cumsum(
        np.square(np.gradient(stiff, axis=-1)), axis=-1
    )
    lost_db -= 0.13 * style.step_mm * np.arange(level_db.shape[-1])
    lost_db += style.shadow_db * _poor_contact(level_db.shape[:2], rng)[..., None]
    amplitude = np.sqrt(np.mean([_look(level_db, border, style, rng) for _ in range(style.looks)], axis=0))
    amplitude *= 10 ** (-lost_db / 20)
    gain_db = style.gain_error_db * np.interp(
        np.arange(amplitude.shape[-1]), np.linspace(0, amplitude.shape[-1] - 1, 6), rng.normal(size=6)
    )
    db = 20 * np.log10(amplitude + 10 ** (style.floor_db / 20)) + gain_db
    top = np.percentile(db, 99.6)
    share = np.clip((db - top + style.range_db) / style.range_db, 0, 1)
    return np.asarray(np.rint(1 + 254 * share**style.gamma), dtype=np.uint8)


def _poor_contact(shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    """Draw (lines, frames) contact, 0 to 1: with poor contact all depths are dark."""
    smooth = ndimage.gaussian_filter(rng.normal(size=shape), 8.0)
    return np.asarray(np.clip(smooth / smooth.std() - 0.8, 0.0, 1.0))


def _look(level_db: FloatArray, border: FloatArray, style: ScanStyle, rng: np.random.Generator) -> FloatArray:
    """Compute the power of one realisation of the speckle; scanners average several."""
    real, imaginary = (rng.normal(size=level_db.shape).astype(np.float32) for _ in range(2))
    field = 10 ** (level_db / 20) * (real + 1j * imaginary)
    field = _blurred(field + border * np.exp(2j * np.pi * rng.random(level_db.shape)), style)
    return np.asarray(np.square(field.real) + np.square(field.imag))


def _blurred(field: AnyArray, style: ScanStyle) -> AnyArray:
    """Apply the point spread: near and far versions blended over the depth, of equal mean power."""
    spacing = np.array([LINE_MM, FRAME_MM, style.step_mm])
    near = np.array([style.lateral_mm, style.elevation_mm, style.axial_mm])
    versions = []
    for wide in (1.0, 1.0 + style.widening):
        sigma = near * (wide, wide, 1.0 + 0.2 * (wide - 1.0)) / spacing
        version = ndimage.gaussian_filter(field.real, sigma) + 1j * ndimage.gaussian_filter(field.imag, sigma)
        versions.append(version * np.sqrt(np.prod(np.maximum(2 * np.sqrt(np.pi) * sigma, 1.0))))
    far = np.linspace(0, 1, field.shape[-1])
    return np.asarray(np.sqrt(1 - far) * versions[0] + np.sqrt(far) * versions[1])


def _reconstructed(
    grey: AnyArray,
    swept: tuple[FloatArray, FloatArray, FloatArray],
    style: ScanStyle,
    fixed_from_probe: Rigid,
    rng: np.random.Generator,
) -> Volume:
    """Reconstruct voxels aligned with the probe, or turned a little as reconstructions are."""
    lines, frames, depths = swept
    reach = style.foot_mm + style.depth_mm
    half = reach * np.sin([lines[-1], frames[-1]]) + 2.0
    size = np.array([2 * half[0], 2 * half[1], style.depth_mm + 4.0])
    count = np.ceil(size / style.voxel_mm).astype(int)
    grid = Grid(
        "fixed",
        (int(count[0]), int(count[1]), int(count[2])),
        fixed_from_probe.apply_array(np.array([-half[0], -half[1], -2.0])),
        np.full(3, style.voxel_mm),
        fixed_from_probe.rotation,
    )
    x, y, z = (
        style.voxel_mm * np.arange(n) + low for n, low in zip(count, (-half[0], -half[1], -2.0), strict=True)
    )
    px, py, pz = np.meshgrid(x, y, z + style.foot_mm, indexing="ij", sparse=True)
    away = np.hypot(py, pz)
    frame = (np.arctan2(py, pz) - frames[0]) / (frames[1] - frames[0])
    line = (np.arctan2(px, away) - lines[0]) / (lines[1] - lines[0])
    depth = (np.sqrt(px**2 + away**2) - style.foot_mm - depths[0]) / style.step_mm
    shape = (int(count[0]), int(count[1]), int(count[2]))
    frame = np.broadcast_to(frame, shape)
    nearest = np.clip(np.rint(frame).astype(int), 0, len(frames) - 1)
    wobble = ndimage.gaussian_filter1d(rng.normal(size=(len(frames), 2)), 3.0, axis=0)
    wobble *= style.jitter_mm / np.maximum(wobble.std(axis=0), 1e-9)
    lost = rng.random(len(frames)) < style.lost_share
    at = [line + wobble[nearest, 0] / LINE_MM, frame, depth + wobble[nearest, 1] / style.step_mm]
    image = ndimage.map_coordinates(grey, at, order=1, mode="nearest", output=np.float32)
    seen = ~lost[nearest]
    for place, n in zip(at, grey.shape, strict=True):
        seen &= (place >= 0) & (place <= n - 1)
    return Volume(grid, np.where(seen, np.rint(image), 0).astype(np.uint8))
