"""LC2 of a slice set against the phase-matched model, as a function of the pose."""

import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray, IntArray, Rigid, read_only_arrays, require_same_frame
from dvf_ig.kernels.compiled import thread_count
from dvf_ig.kernels.lc2 import SUMS, lc2_slices
from dvf_ig.kernels.lc2_step import HELD, NORMAL, lc2_normal_slices
from dvf_ig.registration.pose_chart import HEART_RADIUS_MM

from .channels import ModelChannels
from .density_weights import even_weights, patch_centers_mm
from .slices import SliceSet

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
    """Quadratic model of Σ w(1 − S) in the coordinates of `chart`, local fits held.

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
class Slopes:
    """Attributes:
    misfit: (s,) Σ w(1 − S) of each slice.
    gradient: (s, 6) of the misfit, exact.
    """

    misfit: FloatArray
    gradient: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Square patches of all slices, and what of them depends on the ultrasound alone.

    Attributes:
        first: (s + 1,) where each slice's patches begin.
        boxes: (p, 4) first row, last row + 1, first column, last column + 1.
        moments: (p, 4) one over the pixel count, mean and variance of the ultrasound, and weight: its
            standard deviation, over how often the place was seen where that is asked for.
    """

    first: IntArray
    boxes: IntArray
    moments: FloatArray


def patches_of(slices: SliceSet, radius: int, even_mm: float | None = None) -> Patches:
    """Patches of (2·radius + 1)² pixels, cut at the image border, inside the sector, not flat.

    Args:
        even_mm: width over which neighbours share their weight (see `coverage`); None: they do not.
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
    if even_mm is not None:
        weight *= even_weights(patch_centers_mm(slices, first, chosen), even_mm)
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
        even_mm: float | None = None,
    ) -> None:
        """`even_mm`: see `patches_of`."""
        self._slices = slices
        self._model = model
        self._phases = model.nearest_phase(slices.model_phase)
        radius = max(2, round(patch_mm / pitch_mm / 2))
        self._patches = patches_of(slices, radius, even_mm)
        self._patch_pixels = (2 * radius + 1) ** 2
        s, rows, cols = slices.images.shape
        self._values = np.empty((s, rows, cols, 2))
        self._tables = np.empty((s, rows + 1, cols + 1, SUMS))
        self._out = np.empty((s, 3))
        self._slopes: tuple[FloatArray, FloatArray] | None = None
        self._constant = (
            slices.images,
            slices.masks,
            self._patches.first,
            self._patches.boxes,
            self._patches.moments,
        )
        self._index_from_mm = np.ascontiguousarray(np.linalg.inv(model.grid.axes_mm))
        threads = max(1, min(thread_count(), s))
        self._shares = [round(k * s / threads) for k in range(threads + 1)]
        self._pool = ThreadPoolExecutor(max(1, threads - 1))

    def per_slice(self, mr_from_tracker: Rigid) -> FloatArray:
        """(s, 3) weighted score, weight and overlap of each slice."""
        mr_from_pixel = self._placed(mr_from_tracker)
        arguments = (
            *self._constant,
            np.ascontiguousarray(self._index_from_mm @ mr_from_pixel),
            self._phases,
            self._model.values,
            self._values,
            self._tables,
            self._out,
        )
        self._shared(lc2_slices, arguments)
        return self._out.copy()

    def normal_equations(self, mr_from_tracker: Rigid, center_mm: FloatArray) -> NormalEquations:
        """How the score changes with small motions about `center_mm` (3,), fixed frame."""
        sums = self._normal_sums(mr_from_tracker, center_mm).sum(axis=0)
        lower = np.zeros((6, 6))
        lower[np.tril_indices(6)] = sums[:21]
        matrix = lower + lower.T - np.diag(np.diag(lower))
        weight = max(float(sums[NORMAL + 1]), 1e-300)
        return NormalEquations(matrix, sums[21:NORMAL], float(sums[NORMAL]) / weight, weight)

    def slopes(self, mr_from_tracker: Rigid, center_mm: FloatArray) -> Slopes:
        """Misfit of each slice and its gradient in the coordinates of `chart`."""
        sums = self._normal_sums(mr_from_tracker, center_mm)
        return Slopes(sums[:, NORMAL + 1] - sums[:, NORMAL], -2.0 * sums[:, 21:NORMAL])

    def _normal_sums(self, mr_from_tracker: Rigid, center_mm: FloatArray) -> FloatArray:
        """(s, NORMAL + 2) of `lc2_normal_slices`."""
        mr_from_pixel = self._placed(mr_from_tracker)
        s, rows, cols = self._slices.images.shape
        if self._slopes is None:
            self._slopes = np.empty((s, rows, cols, 6)), np.empty((s, rows + 1, cols + 1, HELD))
        places = mr_from_pixel.copy()
        places[:, :, 2] += self._model.grid.origin_mm - center_mm
        out = np.empty((s, NORMAL + 2))
        arguments = (
            *self._constant,
            np.ascontiguousarray(self._index_from_mm @ mr_from_pixel),
            places,
            self._index_from_mm,
            self._phases,
            self._model.values,
            HEART_RADIUS_MM,
            self._values,
            self._slopes[0],
            self._tables,
            self._slopes[1],
            out,
        )
        self._shared(lc2_normal_slices, arguments)
        return out

    def _placed(self, mr_from_tracker: Rigid) -> FloatArray:
        """(s, 3, 3) mm from the model grid's origin, from (column, row, 1)."""
        require_same_frame(self._slices.frame, mr_from_tracker.source, "registration pose")
        require_same_frame(self._model.grid.frame, mr_from_tracker.target, "registration pose")
        mr_from_pixel = mr_from_tracker.rotation @ self._slices.frame_from_pixel
        mr_from_pixel[:, :, 2] += mr_from_tracker.translation_mm - self._model.grid.origin_mm
        return mr_from_pixel

    def _shared(self, kernel: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
        """Run a kernel over all slices, a share of them on each thread."""
        *others, (begin, end) = itertools.pairwise(self._shares)
        running = [self._pool.submit(kernel, *arguments, *share) for share in others]
        kernel(*arguments, begin, end)
        for share in running:
            share.result()

    def score(self, mr_from_tracker: Rigid) -> Score:
        """Similarity and overlap of all slices together."""
        out = self.per_slice(mr_from_tracker)
        return Score(float(out[:, 0].sum() / max(out[:, 1].sum(), 1e-300)), float(out[:, 2].mean()))

    @property
    def information(self) -> float:
        """Number of independent observations that −n/2·log(1 − S) should count.

        Patches that fit into the slices without sharing pixels, over PATCHES_PER_OBSERVATION.
        """
        return float(self._slices.masks.sum()) / self._patch_pixels / PATCHES_PER_OBSERVATION
