"""Pre-operative 4-D cine MR of the synthetic heart, with its segmentation."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from data_synth.heart.anatomy import PhantomAnatomy
from data_synth.heart.motion import PullBack
from data_synth.heart.reference import ReferenceMap
from data_synth.heart.tissue import FIRST_OUTSIDE, LABEL_NAMES, Tissue, bssfp_signal
from data_synth.threads import for_each
from dvf_ig.core import CycleTiming, FloatArray, Grid, Preop, VolumeSeries

_BLOOD_LEVEL = 800.0
FWHM_PER_SIGMA = 2.3548


@dataclass(frozen=True, slots=True)
class MrProtocol:
    """Protocol of an isotropic 3-D cine, balanced SSFP.

    Attributes:
        phases: N, at i/N of the cycle.
        spacing_mm: voxel pitch.
        margin_mm: field of view beyond the heart box.
        psf_fwhm_mm: point-spread function.
        bias: largest relative coil shading.
        snr: blood signal over the SD of the complex noise in one channel.
    """

    phases: int = 20
    spacing_mm: float = 1.8
    margin_mm: float = 14.0
    psf_fwhm_mm: float = 2.0
    bias: float = 0.2
    snr: float = 40.0


def cine_preop(
    anatomy: PhantomAnatomy, rng: np.random.Generator, protocol: MrProtocol | None = None
) -> Preop:
    """Simulate 4-D MR (int16) and labels (uint8) of the phantom's heart on one grid, frame "mr".

    It is acquired before the intervention, without the mismatch.

    Args:
        rng: draws coil shading and noise.
        protocol: None is `MrProtocol()`.
    """
    protocol = protocol or MrProtocol()
    reference, motion, box_mm = anatomy.reference, anatomy.resting_motion, anatomy.box_mm
    low = box_mm[0] - protocol.margin_mm
    count = np.ceil((box_mm[1] - box_mm[0] + 2 * protocol.margin_mm) / protocol.spacing_mm).astype(int)
    shape = (int(count[0]), int(count[1]), int(count[2]))
    grid = Grid.axis_aligned("mr", shape, low, protocol.spacing_mm)
    timing = CycleTiming(np.arange(protocol.phases) / protocol.phases, anatomy.rr_s)
    shading = coil_shading(grid, protocol.bias, rng)
    noise_rngs = rng.spawn(protocol.phases)
    sigma_px = np.full(3, protocol.psf_fwhm_mm / FWHM_PER_SIGMA / protocol.spacing_mm)
    image = np.empty((protocol.phases, *shape), dtype=np.int16)
    labels = np.empty((protocol.phases, *shape), dtype=np.uint8)

    def acquire(i: int) -> None:
        signal, codes = _phase(grid, reference, motion, float(timing.fractions[i]))
        image[i] = measured(signal * shading, sigma_px, protocol.snr, noise_rngs[i])
        labels[i] = heart_labels(codes)

    for_each(acquire, range(protocol.phases))
    return Preop(
        patient_id=f"phantom-{anatomy.seeds.anatomy}",
        mr=VolumeSeries(grid, image, timing),
        labels=VolumeSeries(grid, labels, timing),
        label_names=LABEL_NAMES,
        organ_labels=tuple(code for code, _ in LABEL_NAMES),
    )


def _phase(
    grid: Grid, reference: ReferenceMap, motion: PullBack, model_phase: float
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Compute noise-free signal and tissue codes of one phase."""
    signal = np.empty(grid.shape, dtype=np.float32)
    codes = np.empty(grid.shape, dtype=np.uint8)
    y, z = (grid.origin_mm[k] + grid.spacing_mm[k] * np.arange(grid.shape[k]) for k in (1, 2))
    plane = np.stack(np.meshgrid(y, z, indexing="ij"), axis=-1).reshape(-1, 2)
    points = np.column_stack([np.empty(len(plane)), plane])
    for i in range(grid.shape[0]):
        points[:, 0] = grid.origin_mm[0] + i * grid.spacing_mm[0]
        reference.sample(motion.pull_back(points, model_phase), signal[i].reshape(-1), codes[i].reshape(-1))
    return signal, codes


def heart_labels(codes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Keep tissue codes of the heart; 0 elsewhere."""
    return np.where((codes > 0) & (codes < FIRST_OUTSIDE), codes, np.uint8(0))


def measured(
    signal: NDArray[np.float32], sigma_px: FloatArray, snr: float, rng: np.random.Generator
) -> NDArray[np.int16]:
    """Apply point-spread function, Rician noise and the receiver's integer scale.

    Args:
        sigma_px: SD of the point-spread function along each axis, in voxels.
        snr: blood signal over the SD of the noise in one channel.
    """
    gain = _BLOOD_LEVEL / bssfp_signal(Tissue.LV_BLOOD)
    level = gain * gaussian_filter(signal, sigma_px)
    noise = _BLOOD_LEVEL / snr
    real = level + noise * rng.standard_normal(level.shape, dtype=np.float32)
    imaginary = noise * rng.standard_normal(level.shape, dtype=np.float32)
    return np.asarray(np.rint(np.hypot(real, imaginary)), dtype=np.int16)


def coil_shading(grid: Grid, bias: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw smooth coil sensitivity 1 ± bias: a second-order polynomial over the field of view."""
    axes = [np.linspace(-1, 1, n) for n in grid.shape]
    x, y, z = np.meshgrid(*axes, indexing="ij", sparse=True)
    terms = [x, y, z, x * y, y * z, x * z, x * x, y * y, z * z]
    field = np.zeros(grid.shape)
    for weight, term in zip(rng.normal(size=len(terms)), terms, strict=True):
        field = field + weight * term
    field -= field.mean()
    return np.asarray(1 + bias * field / np.abs(field).max(), dtype=np.float32)
