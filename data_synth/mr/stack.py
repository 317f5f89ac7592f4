"""Short-axis cine MR as it is acquired: thick slices with gaps, one breath-hold and one heart rate each."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_synth.breathing.motion import DIRECTION
from data_synth.heart.clock import two_segment_phase
from data_synth.heart.motion import PullBack
from data_synth.heart.reference import ReferenceMap
from data_synth.threads import for_each
from dvf_ig.core import CycleTiming, FloatArray, Grid, InvalidInputError, VolumeSeries, read_only_arrays

from .cine import FWHM_PER_SIGMA, coil_shading, heart_labels, measured

_SUBSLICES = 5


@dataclass(frozen=True, slots=True)
class StackProtocol:
    """Protocol of a short-axis stack, balanced SSFP, retrospectively gated slice by slice.

    Attributes:
        phases: N of each slice, at i/N of that slice's own RR interval.
        in_plane_mm, pitch_mm: pixel size, and distance from slice to slice.
        thickness_mm: full width at half maximum of the slice profile (Gaussian); the rest is gap.
        psf_fwhm_mm: in-plane point-spread function.
        bias, snr: as in `MrProtocol`.
        breath_hold_mm: largest displacement of a slice along the breathing motion.
        rr_jitter: largest relative deviation of a slice's RR interval.
    """

    phases: int = 25
    in_plane_mm: float = 1.4
    pitch_mm: float = 10.0
    thickness_mm: float = 6.0
    psf_fwhm_mm: float = 1.8
    bias: float = 0.2
    snr: float = 40.0
    breath_hold_mm: float = 2.0
    rr_jitter: float = 0.1

    def __post_init__(self) -> None:
        if not 0 < self.thickness_mm <= self.pitch_mm:
            raise InvalidInputError(
                f"slices are {self.thickness_mm:g} mm thick every {self.pitch_mm:g} mm; "
                "needed thickness <= pitch"
            )


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class StackCine:
    """Short-axis cine with the truth of each of its k slices.

    Attributes:
        image: int16, slices along the last axis; its timing holds for the mean RR interval.
        labels: uint8 tissue codes of the heart in the middle of each slice, as displaced by its breath-hold.
        slice_rr_s: (k,) RR interval at which each slice was acquired.
        slice_shift_mm: (k, 3) displacement of the heart during each slice, frame "mr".
        trigger_s: (k, phases) delay of each image after its R peak.
    """

    image: VolumeSeries
    labels: VolumeSeries
    slice_rr_s: FloatArray
    slice_shift_mm: FloatArray
    trigger_s: FloatArray


def stack_cine(
    reference: ReferenceMap,
    motion: PullBack,
    grid: Grid,
    timing: tuple[float, float],
    rng: np.random.Generator,
    protocol: StackProtocol,
) -> StackCine:
    """Acquire the slices of `grid`, whose last axis is normal to them.

    Args:
        reference, motion: the pre-operative anatomy.
        grid: from `stack_grid`.
        timing: RR interval in s for which `motion` holds, and end-systole as a fraction of it.
        rng: draws heart rates, breath-holds, coil shading and noise.
    """
    slices, phases = grid.shape[2], protocol.phases
    rr_rng, hold_rng, coil_rng, noise_rng = rng.spawn(4)
    rr_s = timing[0] * (1 + protocol.rr_jitter * rr_rng.uniform(-1, 1, slices))
    shift = protocol.breath_hold_mm * hold_rng.uniform(-1, 1, slices)[:, None] * DIRECTION
    fractions = np.arange(phases) / phases
    model_phase = two_segment_phase(fractions, rr_s[:, None], *timing)
    shading = coil_shading(grid, protocol.bias, coil_rng)
    noise_rngs = noise_rng.spawn(slices)
    image = np.empty((phases, *grid.shape), dtype=np.int16)
    labels = np.empty((phases, *grid.shape), dtype=np.uint8)
    sigma_px = np.full(2, protocol.psf_fwhm_mm / FWHM_PER_SIGMA / protocol.in_plane_mm)

    def acquire(k: int) -> None:
        points = _slice_points(grid, k) - shift[k]
        for i in range(phases):
            signal, codes = _slice(
                reference,
                motion,
                points,
                grid.direction[:, 2],
                float(model_phase[k, i]),
                protocol.thickness_mm,
            )
            shaded = signal.reshape(grid.shape[:2]) * shading[..., k]
            image[i, ..., k] = measured(shaded, sigma_px, protocol.snr, noise_rngs[k])
            labels[i, ..., k] = heart_labels(codes).reshape(grid.shape[:2])

    for_each(acquire, range(slices))
    cycle = CycleTiming(fractions, float(rr_s.mean()))
    return StackCine(
        VolumeSeries(grid, image, cycle),
        VolumeSeries(grid, labels, cycle),
        rr_s,
        shift,
        fractions * rr_s[:, None],
    )


def stack_grid(axes: FloatArray, corner_mm: FloatArray, size_mm: FloatArray, protocol: StackProtocol) -> Grid:
    """Build the grid of a stack.

    Args:
        axes: (3, 3) rotation: two in-plane directions and the slice normal, as columns, frame "mr".
        corner_mm: (3,) first voxel.
        size_mm: (3,) extent along the axes.
    """
    spacing = np.array([protocol.in_plane_mm, protocol.in_plane_mm, protocol.pitch_mm])
    count = np.ceil(size_mm / spacing).astype(int) + 1
    return Grid("mr", (int(count[0]), int(count[1]), int(count[2])), corner_mm, spacing, axes)


def _slice_points(grid: Grid, k: int) -> FloatArray:
    """Compute (nx·ny, 3) pixel centres of slice k."""
    i, j = np.meshgrid(np.arange(grid.shape[0]), np.arange(grid.shape[1]), indexing="ij")
    return grid.to_mm(np.stack([i, j, np.full_like(i, k)], axis=-1).astype(np.float64)).reshape(-1, 3)


def _slice(
    reference: ReferenceMap,
    motion: PullBack,
    points: FloatArray,
    normal: FloatArray,
    model_phase: float,
    thickness_mm: float,
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Average the (n,) signal over the slice profile; also return the codes in the middle of the slice."""
    sigma = thickness_mm / FWHM_PER_SIGMA
    offsets = np.linspace(-2.0, 2.0, _SUBSLICES) * sigma
    weights = np.exp(-0.5 * (offsets / sigma) ** 2)
    weights /= weights.sum()
    total = np.zeros(len(points), dtype=np.float32)
    middle = np.empty(len(points), dtype=np.uint8)
    for offset, weight in zip(offsets, weights, strict=True):
        signal = np.empty(len(points), dtype=np.float32)
        codes = np.empty(len(points), dtype=np.uint8)
        reference.sample(motion.pull_back(points + offset * normal, model_phase), signal, codes)
        total += np.float32(weight) * signal
        if offset == 0.0:
            middle = codes
    return total, middle
