"""B-mode images of a beating synthetic heart."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, InvalidInputError, Rigid
from dvf_ig.core.frames import require_same_frame

from .kernels import sector
from .motion import InverseMotion
from .reference import ReferenceMap
from .ultrasound_probe import LATTICE_MM, SectorProbe

Progress = Callable[[int, int], None]


class Insonified(Protocol):
    """What the simulator needs of an anatomy."""

    @property
    def reference(self) -> ReferenceMap: ...
    @property
    def inverse_motion(self) -> InverseMotion: ...


@dataclass(frozen=True, slots=True, eq=False)
class _Prepared:
    """Tables that depend on the probe alone."""

    angles: FloatArray
    axial: NDArray[np.float32]
    lateral: NDArray[np.float32]
    gain: NDArray[np.float32]
    line_index: NDArray[np.float32]
    sample_index: NDArray[np.float32]
    deviates: NDArray[np.float32]


def simulate_frame(
    anatomy: Insonified,
    probe: SectorProbe,
    mr_from_plane: Rigid,
    line_phases: FloatArray,
    *,
    seed: int,
    frame: int,
) -> NDArray[np.uint8]:
    """One B-mode image, (rows, columns).

    Args:
        mr_from_plane: pose of the image plane ("plane" as defined by `SectorProbe`).
        line_phases: (lines,) model phase at which each line was acquired.
        seed: of the scatterers; the same heart and seed carry the same speckle in every frame.
        frame: number of the frame; blood and receiver noise are redrawn with it.
    Raises:
        InvalidInputError: wrong number of line phases, or a non-finite one.
        FrameMismatchError: the pose is not mr_from_plane.
    """
    phases = _checked_phases(line_phases, (probe.lines,))
    return _frame(anatomy, probe, _prepared(probe), mr_from_plane, phases, seed, frame)


def simulate_lines(
    anatomy: Insonified,
    probe: SectorProbe,
    mr_from_plane: Rigid,
    line_phases: FloatArray,
    *,
    seed: int,
    frame: int,
) -> NDArray[np.float32]:
    """Envelope before log compression and scan conversion: (lines, samples), dB re myocardium's scatter.

    Arguments and errors as in `simulate_frame`.
    """
    phases = _checked_phases(line_phases, (probe.lines,))
    return _lines(anatomy, probe, _prepared(probe), mr_from_plane, phases, seed, frame)


def simulate_sequence(
    anatomy: Insonified,
    probe: SectorProbe,
    mr_from_plane: Sequence[Rigid],
    line_phases: FloatArray,
    *,
    seed: int,
    progress: Progress | None = None,
    threads: int = 2,
) -> NDArray[np.uint8]:
    """(frames, rows, columns) images; bit-identical for any number of threads.

    Args:
        mr_from_plane: pose of the image plane for each frame.
        line_phases: (frames, lines) model phases.
        progress: called with (frames done, frames in all).
    Raises:
        InvalidInputError: phases do not match the poses.
    """
    phases = _checked_phases(line_phases, (len(mr_from_plane), probe.lines))
    prepared = _prepared(probe)
    # cached properties are filled before threads share the anatomy
    _ = (anatomy.reference, anatomy.inverse_motion)
    out = np.empty((len(mr_from_plane), probe.rows, probe.columns), dtype=np.uint8)

    def make(i: int) -> NDArray[np.uint8]:
        return _frame(anatomy, probe, prepared, mr_from_plane[i], phases[i], seed, i)

    with ThreadPoolExecutor(max(1, threads)) as pool:
        for i, image in enumerate(pool.map(make, range(len(out)))):
            out[i] = image
            if progress is not None:
                progress(i + 1, len(out))
    return out


def _checked_phases(line_phases: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    phases = np.asarray(line_phases, dtype=np.float64)
    if phases.shape != shape or not np.isfinite(phases).all():
        raise InvalidInputError(
            f"line phases have shape {phases.shape}; needed {shape} finite values, one for each scan line"
        )
    return phases


def _prepared(probe: SectorProbe) -> _Prepared:
    # one fixed table of deviates; the seed enters through the hash that picks from it
    deviates = np.random.default_rng(20080101).standard_normal((sector.TABLE, 2)) / np.sqrt(2)
    return _Prepared(
        probe.line_angles_rad,
        probe.axial_taps(),
        probe.lateral_taps(),
        probe.receive_gain(),
        *probe.pixel_lookup(),
        deviates.astype(np.float32),
    )


def _frame(
    anatomy: Insonified,
    probe: SectorProbe,
    prepared: _Prepared,
    mr_from_plane: Rigid,
    phases: FloatArray,
    seed: int,
    frame: int,
) -> NDArray[np.uint8]:
    level = _lines(anatomy, probe, prepared, mr_from_plane, phases, seed, frame)
    floor_db = probe.top_db - probe.dynamic_range_db
    grey = np.clip((level - np.float32(floor_db)) * np.float32(255 / probe.dynamic_range_db), 0, 255)
    image = np.empty((probe.rows, probe.columns), dtype=np.uint8)
    sector.scan_convert(grey, prepared.line_index, prepared.sample_index, image)
    return image


def _lines(
    anatomy: Insonified,
    probe: SectorProbe,
    prepared: _Prepared,
    mr_from_plane: Rigid,
    phases: FloatArray,
    seed: int,
    frame: int,
) -> NDArray[np.float32]:
    require_same_frame("mr", mr_from_plane.target, "image plane")
    require_same_frame("plane", mr_from_plane.source, "image plane")
    path, amplitudes = _insonified(anatomy, probe, prepared, mr_from_plane, phases)
    texture_seed, frame_seed = _hash_seeds(seed, frame)
    raster = (probe.lines * probe.fine_lines, 2 * probe.samples)
    parts = np.empty((2, *raster), dtype=np.float32)
    sector.scatter(
        path,
        *amplitudes,
        1.0 / LATTICE_MM,
        prepared.deviates,
        texture_seed,
        frame_seed,
        probe.fine_lines,
        parts[0],
        parts[1],
    )
    pulse = np.empty((raster[0], probe.samples), dtype=np.float32)
    beam = np.empty((2, probe.lines, probe.samples), dtype=np.float32)
    for part, out in zip(parts, beam, strict=True):
        sector.axial_blur(part, prepared.axial, pulse)
        sector.lateral_blur(pulse, prepared.lateral, probe.fine_lines, out)
    level = np.empty((probe.lines, probe.samples), dtype=np.float32)
    noise = np.float32(10 ** (probe.noise_db / 20))
    sector.detect(beam[0], beam[1], noise, prepared.gain, prepared.deviates, frame_seed, level)
    return level


def _insonified(
    anatomy: Insonified, probe: SectorProbe, prepared: _Prepared, mr_from_plane: Rigid, phases: FloatArray
) -> tuple[FloatArray, tuple[NDArray[np.float32], ...]]:
    """Reference positions along the lines, and the amplitudes (tissue, blood, interface) that return."""
    motion, reference = anatomy.inverse_motion, anatomy.reference
    path = np.empty((probe.lines, probe.samples // sector.COARSE + 1, 3))
    rotation = mr_from_plane.rotation
    sector.trace_lines(
        mr_from_plane.translation_mm,
        np.ascontiguousarray(rotation[:, 0]),
        np.ascontiguousarray(rotation[:, 1]),
        prepared.angles,
        probe.step_mm,
        motion.displacement_mm,
        motion.origin_mm,
        1.0 / motion.spacing_mm,
        *motion.bracket(phases),
        path,
    )
    amplitudes = tuple(np.empty((probe.lines, probe.samples), dtype=np.float32) for _ in range(3))
    sector.insonify(
        path,
        reference.acoustics,
        reference.origin_mm,
        1.0 / reference.spacing_mm,
        probe.step_mm,
        probe.frequency_mhz,
        10 ** (probe.specular_db / 20),
        probe.specular_power,
        *amplitudes,
    )
    return path, amplitudes


def _hash_seeds(seed: int, frame: int) -> tuple[np.uint64, np.uint64]:
    """Independent 64-bit seeds of the tissue texture and of this frame's blood and noise."""
    texture = np.random.SeedSequence([seed, 1]).generate_state(1, np.uint64)[0]
    once = np.random.SeedSequence([seed, 2, frame]).generate_state(1, np.uint64)[0]
    return texture, once
