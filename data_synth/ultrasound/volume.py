"""3-D ultrasound: a pyramid of scan lines from a matrix array, converted to voxels."""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from data_synth.kernels import receive, scan
from data_synth.threads import THREADS, for_each, in_order
from dvf_ig.core import FloatArray, Grid, InvalidInputError, Rigid, Volume
from dvf_ig.core.space.frames import require_same_frame

from . import beam
from .probe import SectorProbe
from .scan_lines import (
    AcousticAnatomy,
    InsonifiedLines,
    Raster,
    Seeds,
    beam_tables,
    detect,
    form_beams,
    insonified_lines,
    scatter,
)
from .sequence import checked_phases, log_compressed
from .slice_lattice import fine_lattice

_ROW_SEED = 0x9E3779B97F4A7C15


@dataclass(frozen=True, slots=True)
class MatrixProbe:
    """Square matrix array that steers in two directions.

    Attributes:
        sector: the scan in the plane z = 0; its beam also applies in elevation. Planes and bands are 1.
        tall: lines in elevation; they fan out over the same angle as the sector's.
        voxel_mm: pitch of the converted volume.
    """

    sector: SectorProbe = field(
        default_factory=lambda: SectorProbe(
            lines=64, samples=384, depth_mm=140.0, half_angle_rad=float(np.deg2rad(35)), fine_lines=2
        )
    )
    tall: int = 64
    voxel_mm: float = 1.0

    def __post_init__(self) -> None:
        s = self.sector
        if s.elevation_planes != 1 or s.bands != 1 or s.face_radius_mm != 0:
            raise InvalidInputError("a matrix probe steers a flat array: one plane, one band, no face radius")
        if self.tall < 8 or self.voxel_mm <= 0:
            raise InvalidInputError(
                f"matrix probe has {self.tall} lines in elevation, voxels of {self.voxel_mm:g} mm; "
                "needed at least 8, and positive"
            )

    @property
    def directions(self) -> FloatArray:
        """Unit vectors (tall, lines, 3) of the lines, frame "plane"."""
        rows = np.linspace(-self.sector.half_angle_rad, self.sector.half_angle_rad, self.tall)
        z, x = np.meshgrid(np.tan(rows), np.tan(self.sector.line_angles_rad), indexing="ij")
        raw = np.stack([x, np.ones_like(x), z], axis=-1)
        return np.asarray(raw / np.linalg.norm(raw, axis=-1, keepdims=True))

    @property
    def grid(self) -> Grid:
        """Voxel grid over the pyramid, frame "plane"."""
        s, h = self.sector, self.voxel_mm
        half = int(np.ceil(s.depth_mm * np.sin(s.half_angle_rad) / h))
        side = 2 * half + 1
        deep = int(np.ceil(s.depth_mm / h)) + 1
        return Grid.axis_aligned("plane", (side, deep, side), (-half * h, 0.0, -half * h), h)


@dataclass(frozen=True, slots=True, eq=False)
class EchoVolume:
    """3-D ultrasound image.

    Attributes:
        image: uint8, frame "plane": lateral, depth, elevation.
        mask: uint8 on the same grid, 1 where a voxel was insonified.
    """

    image: Volume
    mask: Volume


def simulate_volume(
    anatomy: AcousticAnatomy,
    probe: MatrixProbe,
    mr_from_plane: Rigid,
    line_phases: FloatArray,
    *,
    seed: int,
    frame: int = 0,
    threads: int = THREADS,
) -> EchoVolume:
    """Simulate one 3-D image, bit-identical for any number of threads.

    Args:
        mr_from_plane: pose of the array.
        line_phases: (tall, lines) model phase of each line.
    Raises:
        InvalidInputError: wrong number of line phases, or a non-finite one.
        FrameMismatchError: the pose is not mr_from_plane.
    """
    level = simulate_pyramid(
        anatomy, probe, mr_from_plane, line_phases, seed=seed, frame=frame, threads=threads
    )
    return shown_volume(level, probe, threads=threads)


def shown_volume(level_db: NDArray[np.float32], probe: MatrixProbe, *, threads: int = THREADS) -> EchoVolume:
    """Convert a pyramid of scan lines to voxels, with log compression."""
    return _converted(log_compressed(level_db, probe.sector), probe, threads)


def simulate_pyramid(
    anatomy: AcousticAnatomy,
    probe: MatrixProbe,
    mr_from_plane: Rigid,
    line_phases: FloatArray,
    *,
    seed: int,
    frame: int = 0,
    threads: int = THREADS,
) -> NDArray[np.float32]:
    """Simulate the envelope before log compression and conversion: (tall, lines, samples), dB.

    Arguments and errors as in `simulate_volume`.
    """
    require_same_frame("mr", mr_from_plane.target, "matrix array")
    require_same_frame("plane", mr_from_plane.source, "matrix array")
    s, seeds = probe.sector, Seeds.of(seed, frame, 1)
    phases = checked_phases(line_phases, (probe.tall, s.lines))
    # cached values are filled before threads share them
    _ = (anatomy.reference, anatomy.inverse_motion, beam_tables(s))
    rows = _insonified_rows(anatomy, probe, mr_from_plane, phases, threads)
    return _detected(probe, _rows_of_beams(probe, rows, seeds, threads), seeds, threads)


def _insonified_rows(
    anatomy: AcousticAnatomy, probe: MatrixProbe, mr_from_plane: Rigid, phases: FloatArray, threads: int
) -> list[InsonifiedLines]:
    """Trace one fan of lines for each of the `tall` rows."""
    directions = probe.directions @ mr_from_plane.rotation.T

    def row(e: int) -> InsonifiedLines:
        return insonified_lines(anatomy, probe.sector, mr_from_plane, directions[e], phases[e])

    return list(in_order(row, range(probe.tall), threads))


def _rows_of_beams(probe: MatrixProbe, rows: list[InsonifiedLines], seeds: Seeds, threads: int) -> Raster:
    """Form (2, tall · fine_lines, lines, samples) echoes laterally and axially but not in elevation."""
    s, fine, tall = probe.sector, probe.sector.fine_lines, probe.tall
    beams = np.empty((2, tall * fine, s.lines, s.samples), dtype=np.float32)
    lattice = fine_lattice()

    def form(m: int) -> None:
        # between rows as the scatterers do between lines: paths interpolated, amplitudes of the nearer row
        place = min(max((m + 0.5) / fine - 0.5, 0.0), tall - 1.0)
        left = min(int(place), tall - 2)
        path = rows[left].path_mm + (place - left) * (rows[left + 1].path_mm - rows[left].path_mm)
        lines = InsonifiedLines(path, rows[m // fine].amplitudes)
        parts = np.zeros((2, s.lines * fine, 2 * s.samples), dtype=np.float32)
        scatter(s, lattice, lines, seeds, 0, parts)
        for part, out in zip(parts, beams[:, m], strict=True):
            form_beams(s, part, out)

    for_each(form, range(tall * fine), threads)
    return beams


def _detected(probe: MatrixProbe, beams: Raster, seeds: Seeds, threads: int) -> NDArray[np.float32]:
    """Compute (tall, lines, samples) dB: the beam in elevation, noise, gain and envelope."""
    s, shape = probe.sector, (probe.tall, probe.sector.lines, probe.sector.samples)
    formed, level = np.empty((2, *shape), dtype=np.float32), np.zeros(shape, dtype=np.float32)
    taps = _elevation_taps(probe)

    def across(part: int) -> None:
        wide = beams[part].reshape(beams.shape[1], -1)
        receive.lateral_blur(wide, taps, s.fine_lines, formed[part].reshape(probe.tall, -1))

    def detected(m: int) -> None:
        # every row of the array has its own receiver noise
        own = Seeds(seeds.texture, np.uint64((int(seeds.frame) + _ROW_SEED * (m + 1)) & (2**64 - 1)))
        detect(s, formed[:, m], own, 0, level[m])
        receive.decibel(level[m], 1.0)

    for_each(across, range(2), threads)
    for_each(detected, range(probe.tall), threads)
    return level


@lru_cache(maxsize=4)
def _elevation_taps(probe: MatrixProbe) -> Raster:
    """Compute (k, lines · samples) weights of the lateral beam across elevation lines."""
    s = probe.sector
    pitch = 2 * s.half_angle_rad / (probe.tall - 1) / s.fine_lines
    taps = beam.lateral_taps(s.lateral_fwhm_mm(s.depths_mm) / s.depths_mm, pitch, s.depths_mm)
    wide = np.tile(taps, (1, s.lines))
    wide.setflags(write=False)
    return wide


def _converted(grey: NDArray[np.float32], probe: MatrixProbe, threads: int) -> EchoVolume:
    grid = probe.grid
    image, mask = np.empty(grid.shape, dtype=np.uint8), np.empty(grid.shape, dtype=np.uint8)
    halves = np.full(2, probe.sector.half_angle_rad)
    parts = np.array_split(np.arange(grid.shape[0]), 8)

    def convert(part: NDArray[np.int64]) -> None:
        scan.scan_convert_slab(
            grey,
            int(part[0]),
            int(part[-1]) + 1,
            probe.voxel_mm,
            grid.origin_mm,
            halves,
            probe.sector.step_mm,
            image,
            mask,
        )

    for_each(convert, parts, threads)
    return EchoVolume(Volume(grid, image), Volume(grid, mask))
