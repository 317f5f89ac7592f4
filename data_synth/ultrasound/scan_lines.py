"""Envelope along scan lines: trace, insonify, scatter, form beams, detect."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from data_synth.heart.fibre_orientation import STRIDE
from data_synth.heart.motion import PullBack
from data_synth.heart.reference import ReferenceMap
from data_synth.kernels import receive, speckle
from data_synth.kernels.insonification import Amplitudes, Pulse, TissueFields, insonify, reverberate
from data_synth.kernels.receive import fill_middles
from data_synth.ultrasound import beam
from dvf_ig.core import FloatArray, InvalidInputError, Rigid, read_only_arrays
from dvf_ig.core.space.frames import require_same_frame

from .probe import FWHM_PER_SIGMA, SectorProbe
from .slice_lattice import Lattice, slice_lattice

COARSE = 8
TOLERANCE_MM = 0.03


def traced_lines(motion: PullBack, points_mm: FloatArray, phases: FloatArray) -> FloatArray:
    """Trace (lines, count, 3) reference positions of points along smooth lines, to TOLERANCE_MM.

    Every COARSE-th point is pulled back. Straight lines connect them, unless second differences show that
    the path bends: there the intervals are halved until they are straight or one step long.

    Args:
        points_mm: (lines, count, 3) evenly spaced along each line, count a multiple of COARSE, plus 1.
        phases: (lines,) model phase of each.
    Raises:
        InvalidInputError: another count.
    """
    count = points_mm.shape[1]
    if count < 2 * COARSE + 1 or count % COARSE != 1:
        raise InvalidInputError(
            f"lines have {count} points; needed a multiple of {COARSE}, plus 1, at least {2 * COARSE + 1}"
        )
    path = np.empty(points_mm.shape)
    nodes = points_mm[:, ::COARSE]
    times = np.repeat(phases, nodes.shape[1])
    path[:, ::COARSE] = motion.pull_back(nodes.reshape(-1, 3), times).reshape(nodes.shape)
    line, interval = np.nonzero(_bent(path[:, ::COARSE]))
    node, stride = interval * COARSE, COARSE
    while stride > 1:
        half = stride // 2
        fill_middles(path, stride)
        middle = node + half
        traced = motion.pull_back(points_mm[line, middle], phases[line])
        missed = ((traced - path[line, middle]) ** 2).sum(axis=1) > (0.5 * TOLERANCE_MM) ** 2
        path[line, middle] = traced
        line, node = np.repeat(line[missed], 2), np.repeat(node[missed], 2)
        node[1::2] += half
        stride = half
    return path


def _bent(nodes_mm: FloatArray) -> NDArray[np.bool_]:
    """Flag (lines, intervals) in which a crease could make the chord miss by TOLERANCE_MM.

    A crease at fraction f of an interval shows as a share 1 − f and f of its bend in the second differences
    at either end, and the chord misses it by f(1 − f) of the bend: by their product over their sum.
    """
    second = nodes_mm[:, 2:] - 2.0 * nodes_mm[:, 1:-1] + nodes_mm[:, :-2]
    bend = np.sqrt((second**2).sum(axis=2))
    # outside the ends of the line anything is possible
    bend = np.pad(bend, ((0, 0), (1, 1)), constant_values=1e9)
    left, right = bend[:, :-1], bend[:, 1:]
    return np.asarray(left * right > TOLERANCE_MM * (left + right))


Raster = NDArray[np.float32]


class AcousticAnatomy(Protocol):
    """Anatomy as the simulator needs it: tissue at end-diastole, and the inverse motion."""

    @property
    def reference(self) -> ReferenceMap: ...
    @property
    def inverse_motion(self) -> PullBack: ...


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BeamTables:
    """Tables that depend only on the probe.

    Attributes:
        axial: pulse, see `beam`.
        lateral: (k, 2·samples) beam, for both halves of the samples.
        end_mm: (samples + 1,) depths of the ends of the samples.
        elevation_mm: (planes, samples + 1) distance of each elevation plane from the middle one there.
        scatter_weight, echo_weight: (planes, samples).
        gain, haze: (samples,) amplitude factors.
        arc_cells: (samples,) lattice cells between two fine lines.
        deviates: (TABLE, 2) complex normal deviates of unit power.
    """

    axial: Raster
    lateral: Raster
    end_mm: FloatArray
    elevation_mm: FloatArray
    scatter_weight: Raster
    echo_weight: Raster
    gain: Raster
    haze: Raster
    arc_cells: FloatArray
    deviates: Raster


@lru_cache(maxsize=8)
def beam_tables(probe: SectorProbe) -> BeamTables:
    """Compute a probe's tables, once for each probe."""
    depths: FloatArray = probe.depths_mm
    radius = probe.face_radius_mm + depths
    pitch = 2 * probe.half_angle_rad / (probe.lines - 1) / probe.fine_lines
    end_mm: FloatArray = probe.step_mm * np.arange(probe.samples + 1.0)
    sigma_mm = probe.elevation_fwhm_mm(end_mm) / FWHM_PER_SIGMA
    # one fixed table of deviates; the seed enters through the hash that selects from it
    deviates = np.random.default_rng(20080101).standard_normal((speckle.TABLE, 2)) / np.sqrt(2)
    return BeamTables(
        beam.axial_taps(probe.axial_fwhm_mm, probe.step_mm),
        np.tile(beam.lateral_taps(probe.lateral_fwhm_mm(depths) / radius, pitch, radius), (1, 2)),
        end_mm,
        beam.elevation_offsets(probe)[:, None] * sigma_mm,
        *beam.elevation_weights(probe),
        beam.receive_gain(probe),
        beam.haze(probe),
        pitch * radius / beam.LATTICE_MM,
        deviates.astype(np.float32),
    )


@dataclass(frozen=True, slots=True)
class Seeds:
    """Seeds of 64 bits: of the tissue texture for each band, and of this frame's blood and noise."""

    texture: tuple[np.uint64, ...]
    frame: np.uint64

    @classmethod
    def of(cls, seed: int, frame: int, bands: int) -> "Seeds":
        texture = np.random.SeedSequence([seed, 1]).generate_state(bands, np.uint64)
        own = np.random.SeedSequence([seed, 2, frame]).generate_state(1, np.uint64)[0]
        return cls(tuple(texture), own)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class InsonifiedLines:
    """Echoes along the beams of one plane.

    Attributes:
        path_mm: (lines, samples + 1, 3) reference positions of the ends of the samples.
        amplitudes: amplitudes that return from each sample.
    """

    path_mm: FloatArray
    amplitudes: Amplitudes


def envelope_lines(
    anatomy: AcousticAnatomy,
    probe: SectorProbe,
    mr_from_plane: Rigid,
    phases: FloatArray,
    seed: int,
    frame: int,
) -> Raster:
    """Simulate the (lines, samples) envelope in dB relative to myocardium, before log compression."""
    require_same_frame("mr", mr_from_plane.target, "image plane")
    require_same_frame("plane", mr_from_plane.source, "image plane")
    seeds = Seeds.of(seed, frame, probe.bands)
    lattice = slice_lattice(probe, mr_from_plane.rotation[:, 2])
    directions = probe.directions @ mr_from_plane.rotation.T
    planes = [
        insonified_lines(anatomy, probe, mr_from_plane, directions, phases, plane)
        for plane in range(probe.elevation_planes)
    ]
    envelope = np.zeros((probe.lines, probe.samples), dtype=np.float32)
    beams = np.empty((2, probe.lines, probe.samples), dtype=np.float32)
    for band in range(probe.bands):
        parts = np.zeros((2, probe.lines * probe.fine_lines, 2 * probe.samples), dtype=np.float32)
        for lines in planes:
            scatter(probe, lattice, lines, seeds, band, parts)
        add_haze(probe, seeds, band, parts)
        for part, formed in zip(parts, beams, strict=True):
            form_beams(probe, part, formed)
        detect(probe, beams, seeds, band, envelope)
    receive.decibel(envelope, 1.0 / probe.bands)
    return envelope


def insonified_lines(
    anatomy: AcousticAnatomy,
    probe: SectorProbe,
    mr_from_plane: Rigid,
    directions: FloatArray,
    phases: FloatArray,
    plane: int = 0,
) -> InsonifiedLines:
    """Trace the scan lines back to end-diastole, and compute the echoes along them.

    Args:
        directions: (lines, 3) unit vectors of the scan lines, frame "mr".
        phases: (lines,) model phase of each.
        plane: index of the elevation plane.
    """
    tables = beam_tables(probe)
    along_mm = probe.face_radius_mm + tables.end_mm[:, None]
    points = mr_from_plane.translation_mm + along_mm * directions[:, None, :]
    if probe.elevation_planes > 1:
        points += tables.elevation_mm[plane][:, None] * mr_from_plane.rotation[:, 2]
    path = traced_lines(anatomy.inverse_motion, points, phases)
    amplitudes = _returned(path, anatomy.reference, probe)
    if probe.elevation_planes > 1:
        for scattered in (amplitudes.tissue, amplitudes.blood):
            scattered *= tables.scatter_weight[plane]
        amplitudes.interface[:] *= tables.echo_weight[plane]
    return InsonifiedLines(path, amplitudes)


def _returned(path: FloatArray, reference: ReferenceMap, probe: SectorProbe) -> Amplitudes:
    """Compute amplitudes along (lines, samples + 1, 3) paths, with reverberations."""
    tissue, blood, interface = (np.empty((len(path), path.shape[1] - 1), dtype=np.float32) for _ in range(3))
    out = Amplitudes(tissue, blood, interface, np.zeros((len(path), 3)))
    per_mm = 1.0 / reference.spacing_mm
    fibres_per_mm = 1.0 / (STRIDE * reference.spacing_mm)
    fields = TissueFields(
        reference.acoustics, reference.origin_mm, per_mm, reference.fibre_orientation, fibres_per_mm
    )
    specular = 10 ** (probe.specular_db / 20)
    pulse = Pulse(probe.step_mm, probe.frequency_mhz, specular, probe.specular_power)
    insonify(path, fields, pulse, out)
    reverberate(out, probe.step_mm, probe.face_reflection, 10 ** (probe.dirty_shadow_db / 20))
    return out


def scatter(
    probe: SectorProbe, lattice: Lattice, lines: InsonifiedLines, seeds: Seeds, band: int, parts: Raster
) -> None:
    """Add the echoes of the scatterers along `lines` to `parts` (2, lines·fine, 2·samples)."""
    scatterers = speckle.Scatterers(
        lattice.per_mm,
        beam_tables(probe).deviates,
        np.uint64(int(seeds.texture[band]) ^ lattice.number),
        np.uint64(int(seeds.frame) ^ band),
    )
    path = lines.path_mm @ lattice.axes.T
    speckle.scatter(path, lines.amplitudes, scatterers, probe.fine_lines, parts[0], parts[1])


def add_haze(probe: SectorProbe, seeds: Seeds, band: int, parts: Raster) -> None:
    """Add near-field clutter, if the probe has any."""
    if probe.haze_db == -np.inf:
        return
    tables = beam_tables(probe)
    depth_cells = 0.5 * probe.step_mm / beam.LATTICE_MM
    still = np.uint64(int(seeds.texture[band]) ^ 0x4A2E)
    speckle.add_clutter(
        tables.haze, tables.arc_cells, depth_cells, tables.deviates, still, parts[0], parts[1]
    )


def form_beams(probe: SectorProbe, part: Raster, out: Raster) -> None:
    """Apply lateral beam and axial pulse: (lines·fine, 2·samples) to (lines, samples)."""
    tables = beam_tables(probe)
    wide = np.empty((probe.lines, part.shape[1]), dtype=np.float32)
    receive.lateral_blur(part, tables.lateral, probe.fine_lines, wide)
    receive.axial_blur(wide, tables.axial, out)


def detect(probe: SectorProbe, beams: Raster, seeds: Seeds, band: int, envelope: Raster) -> None:
    """Apply receiver noise and gain to `beams` (2, lines, samples); add their envelope to `envelope`."""
    tables, noise = beam_tables(probe), np.float32(10 ** (probe.noise_db / 20))
    receive.detect(beams[0], beams[1], noise, tables.gain, band, tables.deviates, seeds.frame, envelope)
