"""Cine MR of the second world: slices from many breath-holds, and labels as an observer draws them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from data_synth.heart.motion import HeartMotion
from data_synth.heart.tissue import FIRST_OUTSIDE, LABEL_NAMES, Tissue
from data_synth.kernels import tissue_map
from data_synth.mr.examination import Examination, ExamName, Scanner, examination
from data_synth.seeds import child_rng
from data_synth.threads import for_each
from dvf_ig.core import CycleTiming, FloatArray, Grid, Preop, VolumeSeries, read_only_arrays

from .clock import CycleLaw
from .drawn import Drawn
from .random_fields import grid_noise, wide_noise
from .resting_heart import RestingHeart
from .tissue_fields import TissueFields

MARGIN_MM = 16.0
KEY_PHASES = 4
"""Phases at which contours are drawn, interpolated between them."""
_PROFILE = ((-0.33, 0.25), (0.0, 0.5), (0.33, 0.25))
"""Slice profile: offset as a share of the thickness, and weight."""
_FWHM_PER_SIGMA = 2.3548


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SliceErrors:
    """Errors of each of k slices.

    Attributes:
        phases: (k, n) model phase of each image of each slice.
        shift_mm: (k, 3) displacement of the heart in its breath-hold, frame "mr"; no mean, no linear trend.
    """

    phases: FloatArray
    shift_mm: FloatArray


def cine(heart: RestingHeart, fields: TissueFields, law: CycleLaw, drawn: Drawn) -> Preop:
    """Acquire the heart before the intervention, and segment it."""
    grid = slice_grid(heart, drawn)
    count = round(drawn["mr.phases"])
    errors = slice_errors(grid, count, law, drawn)
    shading = _shading(grid, drawn)
    warp = _ContourErrors(grid, fields, drawn)
    motion = heart.resting_motion
    image = np.empty((count, *grid.shape), dtype=np.int16)
    labels = np.empty((count, *grid.shape), dtype=np.uint8)

    def acquire(i: int) -> None:
        material = _material(grid, motion, errors, i)
        signal = _signal(fields, grid, material, drawn["mr.slice_mm"]) * shading
        image[i] = _measured(signal, grid, drawn, child_rng(drawn.seed, f"second world mr noise {i}"))
        labels[i] = warp.labels(material, i)

    for_each(acquire, range(count))
    timing = CycleTiming(np.arange(count) / count, heart.rr_s)
    return Preop(
        patient_id=f"second-world-{drawn.seed}",
        mr=VolumeSeries(grid, image, timing),
        labels=VolumeSeries(grid, labels, timing),
        label_names=LABEL_NAMES,
        organ_labels=tuple(code for code, _ in LABEL_NAMES),
    )


def examine(
    heart: RestingHeart, fields: TissueFields, exam: ExamName, drawn: Drawn, phases: int | None = None
) -> Examination:
    """Examine the heart before the intervention as a hospital does.

    Args:
        phases: number of them instead of the drawn one, to save time.
    """
    scanner = Scanner(
        in_plane_mm=drawn["mr.in_plane_mm"],
        psf_fwhm_mm=drawn["mr.psf_mm"],
        bias=drawn["mr.bias"],
        snr=drawn["mr.snr"],
        breath_hold_mm=np.sqrt(3.0) * drawn["mr.slice_shift_mm"],  # even up to there: of that RMS
        rr_jitter=drawn["mr.rr_jitter"],
    )
    rng = child_rng(drawn.seed, "second world examination")
    return examination(heart, fields.reference, exam, rng, phases, scanner)


def segmented(examined: Examination, heart: RestingHeart, fields: TissueFields, drawn: Drawn) -> Preop:
    """Take the cines of an examination, with labels as an observer draws them at end-diastole."""
    grid = examined.sax.image.grid
    errors = SliceErrors(np.zeros((grid.shape[2], 1)), examined.sax.slice_shift_mm)
    material = _material(grid, heart.resting_motion, errors, 0)
    contours = _ContourErrors(grid, fields, drawn).labels(material, 0)
    return examined.preop(f"second-world-{drawn.seed}", contours)


def slice_grid(heart: RestingHeart, drawn: Drawn) -> Grid:
    """Transverse slices over the heart, tilted by up to the drawn obliquity about a random axis."""
    axis = child_rng(drawn.seed, "second world mr axis").standard_normal(3)
    turn = np.deg2rad(drawn["mr.obliquity_deg"]) * axis / np.linalg.norm(axis)
    axes = Rotation.from_rotvec(turn).as_matrix()
    local = heart.ed_vertices_mm @ axes
    low, high = local.min(axis=0) - MARGIN_MM, local.max(axis=0) + MARGIN_MM
    pixel = drawn["mr.in_plane_mm"]
    spacing = np.array([pixel, pixel, drawn["mr.slice_mm"]])
    size = np.ceil((high - low) / spacing).astype(int) + 1
    return Grid("mr", (int(size[0]), int(size[1]), int(size[2])), axes @ low, spacing, axes)


def slice_errors(grid: Grid, count: int, law: CycleLaw, drawn: Drawn) -> SliceErrors:
    """Draw heart rate, gate and breath-hold of every slice."""
    slices = grid.shape[2]
    rng = child_rng(drawn.seed, "second world slices")
    rr_s = law.model_rr_s * (1.0 + drawn["mr.rr_jitter"] * rng.uniform(-1, 1, slices))
    late = drawn["mr.gate_noise_s"] * rng.standard_normal(slices) / rr_s
    fractions = (np.arange(count) / count + late[:, None]) % 1.0
    # breath-holds differ mostly along the body
    shift = drawn["mr.slice_shift_mm"] * rng.standard_normal((slices, 3)) * np.array([0.3, 0.4, 0.87])
    place = np.stack([np.ones(slices), np.arange(slices) - 0.5 * (slices - 1)], axis=1)
    shift -= place @ np.linalg.lstsq(place, shift, rcond=None)[0]
    return SliceErrors(law.model_phase(fractions, rr_s[:, None]), shift)


def _material(grid: Grid, motion: HeartMotion, errors: SliceErrors, i: int) -> FloatArray:
    """Compute (nx, ny, nz, 3) end-diastolic positions of the voxels of image i of every slice."""
    out = np.empty((*grid.shape, 3))
    j, k = np.meshgrid(np.arange(grid.shape[0]), np.arange(grid.shape[1]), indexing="ij")
    for s in range(grid.shape[2]):
        index = np.stack([j, k, np.full_like(j, s)], axis=-1).reshape(-1, 3)
        points = grid.to_mm(index.astype(np.float64)) - errors.shift_mm[s]
        out[:, :, s] = motion.pull_back(points, float(errors.phases[s, i])).reshape(*grid.shape[:2], 3)
    return out


def _signal(fields: TissueFields, grid: Grid, material: FloatArray, slice_mm: float) -> NDArray[np.float32]:
    """Average the signal over the slice's thickness; strain within a slice's half is left out."""
    reference = fields.reference
    total = np.zeros(grid.shape, dtype=np.float32)
    part = np.empty(material.size // 3, dtype=np.float32)
    codes = np.empty(len(part), dtype=np.uint8)
    for offset, weight in _PROFILE:
        points = (material + offset * slice_mm * grid.direction[:, 2]).reshape(-1, 3)
        reference.sample(points, part, codes)
        total += np.float32(weight) * part.reshape(grid.shape)
    return total


def _measured(
    signal: NDArray[np.float32], grid: Grid, drawn: Drawn, rng: np.random.Generator
) -> NDArray[np.int16]:
    """Apply the point spread in the plane, then the magnitude of a signal with complex noise."""
    sigma = drawn["mr.psf_mm"] / _FWHM_PER_SIGMA / drawn["mr.in_plane_mm"]
    blurred = gaussian_filter(signal, (sigma, sigma, 0.0))
    noise = np.float32(np.quantile(blurred, 0.98) / drawn["mr.snr"])
    real, imaginary = rng.standard_normal((2, *grid.shape), dtype=np.float32) * noise
    return np.asarray(np.rint(np.hypot(blurred + real, imaginary)), dtype=np.int16)


def _shading(grid: Grid, drawn: Drawn) -> NDArray[np.float32]:
    rng = child_rng(drawn.seed, "second world coils")
    noise = wide_noise(grid.shape, grid.spacing_mm, drawn["mr.bias_length_mm"], rng)
    return np.asarray(np.exp(np.clip(drawn["mr.bias"] * noise, -1.2, 1.2)), dtype=np.float32)


class _ContourErrors:
    """Errors of an observer's contours: noise, bias, and the valve plane too high or low."""

    def __init__(self, grid: Grid, fields: TissueFields, drawn: Drawn) -> None:
        self.grid, self.fields, self.drawn = grid, fields, drawn
        self.count = round(drawn["mr.phases"])
        self.common = self._noise("always")
        self.own = [self._noise(str(key)) for key in range(KEY_PHASES)]
        axis, base = _valve_plane(fields)
        self.axis, self.base = axis, base

    def _noise(self, stream: str) -> FloatArray:
        """Draw (nx, ny, nz, 3) displacements of unit RMS along any direction, without a mean."""
        rng = child_rng(self.drawn.seed, f"second world contours {stream}")
        length = self.drawn["labels.noise_length_mm"]
        parts = [grid_noise(self.grid.shape, self.grid.spacing_mm, length, rng) for _ in range(3)]
        field = np.stack(parts, axis=-1)
        return np.asarray(field - field.mean(axis=(0, 1, 2)), dtype=np.float32)

    def labels(self, material: FloatArray, i: int) -> NDArray[np.uint8]:
        """Draw the labels of image i."""
        shared = self.drawn["labels.noise_kept"]
        place_in_cycle = KEY_PHASES * i / self.count
        first, share = int(place_in_cycle), place_in_cycle % 1.0
        own = (1 - share) * self.own[first] + share * self.own[(first + 1) % KEY_PHASES]
        own *= np.sqrt((1.0 - shared**2) / ((1 - share) ** 2 + share**2))
        noise = shared * self.common + own
        place = (material + self.drawn["labels.noise_mm"] * noise).reshape(-1, 3)
        near = np.exp(-0.5 * (((place - self.base) @ self.axis) / self.drawn["labels.basal_reach_mm"]) ** 2)
        inside = place - (self.drawn["labels.basal_mm"] * near)[:, None] * self.axis
        reference = self.fields.reference
        organ, codes = np.empty(len(place), dtype=np.float32), np.empty(len(place), dtype=np.uint8)
        nowhere = np.zeros((2, 2, 2), dtype=np.uint8)
        depth = reference.organ_mm + np.float32(self.fields.outer_bias_mm)
        at = (reference.origin_mm, 1.0 / reference.spacing_mm)
        tissue_map.sample_mr(place, depth, nowhere, nowhere, depth, *at, organ, codes)
        labels = self.fields.drawn_labels
        tissue_map.sample_mr(inside, depth, labels, labels, depth, *at, np.empty_like(organ), codes)
        heart = (organ > 0) & (codes < FIRST_OUTSIDE)
        return np.where(heart, codes, 0).astype(np.uint8).reshape(self.grid.shape)


def _valve_plane(fields: TissueFields) -> tuple[FloatArray, FloatArray]:
    """Find the unit axis from the left ventricle to its atrium, and a point of the plane between them."""
    reference = fields.reference
    blood = {}
    for chamber in (Tissue.LV_BLOOD, Tissue.LA_BLOOD):
        nodes = np.argwhere((reference.inner == chamber) & (reference.organ_mm > 0))
        blood[chamber] = reference.origin_mm + reference.spacing_mm * nodes
    lv, la = blood[Tissue.LV_BLOOD], blood[Tissue.LA_BLOOD]
    axis = la.mean(axis=0) - lv.mean(axis=0)
    axis /= np.linalg.norm(axis)
    height = 0.5 * (np.quantile(lv @ axis, 0.98) + np.quantile(la @ axis, 0.02))
    return axis, lv.mean(axis=0) + (height - lv.mean(axis=0) @ axis) * axis
