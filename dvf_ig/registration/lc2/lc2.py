"""LC2 of a slice set against the phase-matched model, as a function of the pose."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dvf_ig.core import HEART_RADIUS_MM, FloatArray, IntArray, Rigid, read_only_arrays, require_same_frame
from dvf_ig.kernels.lc2 import (
    SLICE_OVERLAP,
    SLICE_SCORE,
    SLICE_WEIGHT,
    SUMS,
    PatchedSlices,
    PlacedModel,
    lc2_slices,
)
from dvf_ig.kernels.lc2_step import (
    COEFFICIENT_SUMS,
    STEP_SCORE,
    STEP_SUMS,
    STEP_WEIGHT,
    TRIANGLE,
    RigidMotion,
    StepScratch,
    lc2_normal_slices,
)

from .channels import ModelChannels
from .density_weights import inverse_density_weights, patch_centers_mm
from .slices import SliceSet
from .threads import SliceThreads

MIN_FILL = 0.6
"""Least share of a patch that must lie inside the sector."""
FLAT = 1e-12
"""Variance below which a patch of ultrasound carries nothing to explain."""
PATCHES_PER_OBSERVATION = 6.0
"""Neighbouring slices see the same tissue and share its difference from the model: with this divisor the
standard deviations match the errors of registrations on tuning seeds 101–104 (mismatch 1.2 mm)."""
CENTER_STEP = 2
"""A patch is centred on every second pixel of every second row: neighbours share nearly all their pixels."""


@dataclass(frozen=True, slots=True)
class Score:
    """similarity in [0, 1] (share of local ultrasound variance explained), overlap in [0, 1]."""

    similarity: float
    overlap: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Quadratic model of Σ w(1 − S) in the coordinates of `PoseChart`, coefficients of the local fits fixed.

    Attributes:
        matrix: (6, 6) JᵀJ; right: (6,) Jᵀr, half the gradient of Σ w·S.
        similarity, weight: S over all slices, and Σ w.
    """

    matrix: FloatArray
    right: FloatArray
    similarity: float
    weight: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class CostGradient:
    """LC2's cost of every slice, and its gradient over the pose.

    Attributes:
        cost: (s,) Σ w(1 − S) of each slice.
        gradient: (s, 6) of the cost in the coordinates of `PoseChart`, exact.
    """

    cost: FloatArray
    gradient: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Square patches of all slices, and what of them depends on the ultrasound alone.

    Attributes:
        first: (s + 1,) where each slice's patches begin.
        boxes: (p, 4) first row, last row + 1, first column, last column + 1.
        moments: (p, 4) one over the pixel count, mean and variance of the ultrasound, and weight: its
            standard deviation, over the density of patches where a width of density is given.
    """

    first: IntArray
    boxes: IntArray
    moments: FloatArray


def patches_of(slices: SliceSet, radius: int, density_width_mm: float | None = None) -> Patches:
    """Patches of (2·radius + 1)² pixels, cut at the image border, inside the sector, not flat.

    Args:
        density_width_mm: width over which neighbours share weight (see `density_weights`); None: they do not.
    """
    rows, cols = slices.images.shape[1:]
    row, col = (a.ravel() for a in np.mgrid[0:rows:CENTER_STEP, 0:cols:CENTER_STEP])
    boxes = np.column_stack(
        [
            np.maximum(row - radius, 0),
            np.minimum(row + radius + 1, rows),
            np.maximum(col - radius, 0),
            np.minimum(col + radius + 1, cols),
        ]
    ).astype(np.int64)
    images, masks = slices.images.astype(np.float64), slices.masks
    count, total, squares = (
        _window_sums(stack, radius) for stack in (masks.astype(np.float64), images, images * images)
    )
    full = masks[:, row, col] & (count >= MIN_FILL * (2 * radius + 1) ** 2)
    inverse = 1.0 / np.maximum(count, 1.0)
    mean = total * inverse
    variance = squares * inverse - mean * mean
    use = full & (variance > FLAT)
    first = np.concatenate([[0], np.cumsum(use.sum(axis=1))]).astype(np.int64)
    chosen, weight = boxes[np.nonzero(use)[1]], np.sqrt(variance[use])
    if density_width_mm is not None:
        weight *= inverse_density_weights(patch_centers_mm(slices, first, chosen), density_width_mm)
    return Patches(first, chosen, np.column_stack([inverse[use], mean[use], variance[use], weight]))


def _window_sums(stack: FloatArray, radius: int) -> FloatArray:
    """(s, patches) sum over the square window about every patch centre, zeros beyond the border."""
    rows, cols = stack.shape[1:]
    padded = np.pad(stack, ((0, 0), (radius, radius), (radius, radius)))
    shifts = range(2 * radius + 1)
    across = np.sum([padded[:, :, k : k + cols : CENTER_STEP] for k in shifts], axis=0)
    down = np.sum([across[:, k : k + rows : CENTER_STEP] for k in shifts], axis=0)
    return np.asarray(down.reshape(len(stack), -1))


class Lc2:
    """Scores a pose. Holds scratch memory, so one instance serves one thread of Python.

    Source: Wein 2013, eq. 3–5. Differs from source: 2-D patches in the tracked slices, phase-matched volumes.
    """

    def __init__(
        self,
        slices: SliceSet,
        model: ModelChannels,
        *,
        patch_mm: float,
        pitch_mm: float,
        density_width_mm: float | None = None,
        threads: SliceThreads | None = None,
        patches: Patches | None = None,
    ) -> None:
        """LC2 of a slice set against a model, at any pose.

        Args:
            slices, model: what is compared with what.
            patch_mm: edge of a patch; pitch_mm: of a pixel.
            density_width_mm: see `patches_of`.
            threads: of the caller, who closes them; without any all slices run on the calling thread.
            patches: of the slices, in place of all that `patches_of` finds.
        """
        self.slices = slices
        self._model = model
        self._threads = threads
        self._sizes = (patch_mm, pitch_mm)
        self._phases = model.nearest_phase(slices.model_phase)
        radius = max(2, round(patch_mm / pitch_mm / 2))
        if patches is None:
            patches = patches_of(slices, radius, density_width_mm)
        self.patches = patches
        self._patch_pixels = (2 * radius + 1) ** 2
        self._patched = PatchedSlices(
            slices.images, slices.masks, patches.first, patches.boxes, patches.moments
        )
        s, rows, cols = slices.images.shape
        self._values = np.empty((s, rows, cols, 2))
        self._tables = np.empty((s, rows + 1, cols + 1, SUMS))
        self._step_scratch: StepScratch | None = None
        self._last_equations: tuple[Rigid, FloatArray, NormalEquations] | None = None
        self._index_from_mm = np.ascontiguousarray(np.linalg.inv(model.grid.axes_mm))

    def with_patches(self, slices: SliceSet, patches: Patches) -> "Lc2":
        """The same metric of other slices, by patches that were found already."""
        patch_mm, pitch_mm = self._sizes
        return Lc2(
            slices, self._model, patch_mm=patch_mm, pitch_mm=pitch_mm, threads=self._threads, patches=patches
        )

    def per_slice(self, target_from_source: Rigid) -> FloatArray:
        """(s, 3) weighted score, weight and overlap of each slice."""
        model, _ = self._placed(target_from_source)
        out = np.empty((len(self.slices), 3))
        self._run(lc2_slices, (self._patched, model, self._values, self._tables, out))
        return out

    def score(self, target_from_source: Rigid) -> Score:
        """Similarity and overlap of all slices together."""
        out = self.per_slice(target_from_source)
        weight = max(out[:, SLICE_WEIGHT].sum(), 1e-300)
        return Score(float(out[:, SLICE_SCORE].sum() / weight), float(out[:, SLICE_OVERLAP].mean()))

    def similarity_at_shift(self, target_from_source: Rigid, shift: float) -> float:
        """Similarity if every slice belonged `shift` of a cycle later in the model's cycle than was taken."""
        model, _ = self._placed(target_from_source)
        phases = self._model.nearest_phase((self.slices.model_phase + shift) % 1.0)
        out = np.empty((len(self.slices), 3))
        self._run(lc2_slices, (self._patched, model._replace(phases=phases), self._values, self._tables, out))
        return float(out[:, SLICE_SCORE].sum() / max(out[:, SLICE_WEIGHT].sum(), 1e-300))

    def normal_equations(self, target_from_source: Rigid, center_mm: FloatArray) -> NormalEquations:
        """How the score changes with small motions about `center_mm` (3,), target frame.

        Those of the last pose are kept: a search ends, as a rule, at the pose that it evaluated last.
        """
        last = self._last_equations
        if last is not None and last[0] is target_from_source and last[1] is center_mm:
            return last[2]
        sums = self._step_sums(target_from_source, center_mm).sum(axis=0)
        lower = np.zeros((6, 6))
        lower[np.tril_indices(6)] = sums[:TRIANGLE]
        matrix = lower + lower.T - np.diag(np.diag(lower))
        weight = max(float(sums[STEP_WEIGHT]), 1e-300)
        equations = NormalEquations(
            matrix, sums[TRIANGLE:STEP_SCORE], float(sums[STEP_SCORE]) / weight, weight
        )
        self._last_equations = (target_from_source, center_mm, equations)
        return equations

    def cost_gradient(self, target_from_source: Rigid, center_mm: FloatArray) -> CostGradient:
        """Cost of each slice and its gradient in the coordinates of `PoseChart`."""
        sums = self._step_sums(target_from_source, center_mm)
        return CostGradient(sums[:, STEP_WEIGHT] - sums[:, STEP_SCORE], -2.0 * sums[:, TRIANGLE:STEP_SCORE])

    @property
    def information(self) -> float:
        """Number of independent observations that −n/2·log(1 − S) should count.

        Patches that fit into the slices without sharing pixels, over PATCHES_PER_OBSERVATION.
        """
        return float(self.slices.masks.sum()) / self._patch_pixels / PATCHES_PER_OBSERVATION

    def _step_sums(self, target_from_source: Rigid, center_mm: FloatArray) -> FloatArray:
        """(s, STEP_SUMS) of `lc2_normal_slices`."""
        model, mm_from_pixel = self._placed(target_from_source)
        mm_from_pixel[:, :, 2] += self._model.grid.origin_mm - center_mm
        motion = RigidMotion(mm_from_pixel, self._index_from_mm, HEART_RADIUS_MM)
        out = np.empty((len(self.slices), STEP_SUMS))
        self._run(lc2_normal_slices, (self._patched, model, motion, self._scratch(), out))
        return out

    def _scratch(self) -> StepScratch:
        """Made when a step is first asked for: a metric that only scores needs a third of the memory."""
        if self._step_scratch is None:
            s, rows, cols = self.slices.images.shape
            gradients = np.empty((s, rows, cols, 6))
            coefficients = np.empty((s, rows + 1, cols + 1, COEFFICIENT_SUMS))
            self._step_scratch = StepScratch(self._values, gradients, self._tables, coefficients)
        return self._step_scratch

    def _placed(self, target_from_source: Rigid) -> tuple[PlacedModel, FloatArray]:
        """The model at a pose, and (s, 3, 3) mm from its grid's origin from (column, row, 1)."""
        require_same_frame(self.slices.frame, target_from_source.source, "registration pose")
        require_same_frame(self._model.grid.frame, target_from_source.target, "registration pose")
        mm_from_pixel = target_from_source.rotation @ self.slices.frame_from_pixel
        mm_from_pixel[:, :, 2] += target_from_source.translation_mm - self._model.grid.origin_mm
        index_from_pixel = np.ascontiguousarray(self._index_from_mm @ mm_from_pixel)
        return PlacedModel(self._model.values, self._phases, index_from_pixel), mm_from_pixel

    def _run(self, kernel: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
        """A kernel over all slices."""
        if self._threads is None:
            kernel(*arguments, 0, len(self.slices))
        else:
            self._threads.run(kernel, arguments, len(self.slices))
