"""LC2, the local linear combination of two model channels, of a slice set as a function of the pose.

The kernels sum over each slice's pixels, at h = (column, row, 1) and in voxels. With x = P h the position of
a pixel, in mm from the centre of rotation, a small motion ξ (see `PoseChart`) moves the model past it by
Bᵀ(h) ξ, B(h) = (x × ·/ρ, ·): linear in h, so B(h) = Σ_k h_k B_k (`SliceMotion`).

Source: Wein 2013, eqs 3–5 (docs/theory/registration.md, section 4).
"""

import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import numpy as np

from dvf_ig.core import (
    HEART_RADIUS_MM,
    FloatArray,
    IntArray,
    InvalidInputError,
    Rigid,
    read_only_arrays,
    require_same_frame,
)
from dvf_ig.kernels.compiled import thread_count
from dvf_ig.kernels.lc2.parts import SliceParts, lc2_step_parts
from dvf_ig.kernels.lc2.slices import (
    PIXEL,
    SLICE_OVERLAP,
    SLICE_SCORE,
    SLICE_WEIGHT,
    SUMS,
    PatchedSlices,
    PlacedModel,
    Scratch,
    lc2_slices,
)
from dvf_ig.kernels.lc2.step import FORCE, MATRIX, STEP_SCORE, STEP_SUMS, STEP_WEIGHT, lc2_step_slices

from .channels import ModelChannels
from .patches import patches_of, pixel_runs, slice_parts
from .slices import SliceSet

_TRIANGLE = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])
"""Where the entries of a symmetric matrix lie in its lower triangle by rows."""
_MATRIX = MATRIX + 6 * _TRIANGLE[:, None, :, None] + _TRIANGLE[None, :, None, :]
"""(3, 3, 3, 3) columns of h_k h_l G_ab among a slice's sums, by k, a, l, b."""
PATCHES_PER_OBSERVATION = 6.0
"""Neighbouring slices see the same tissue and share its difference from the model: with this divisor the
standard deviations match the errors of registrations on tuning seeds 101–104 (mismatch 1.2 mm)."""


class SliceThreads:
    """Runs a kernel over slices, an equal share of them on each thread, the caller's own among them.

    A context manager: its threads end with it, and what outlives it runs on the caller's thread. Kernels
    write one row a slice, so results do not depend on the number of threads.
    """

    def __init__(self) -> None:
        self.count = thread_count()
        self._pool = ThreadPoolExecutor(max(1, self.count - 1))

    def __enter__(self) -> "SliceThreads":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pool.shutdown()
        self.count = 1

    def run(self, work: Callable[[int, int, int], object], items: int) -> None:
        """work(worker, begin, end) over 0 <= item < `items`, in a range for each thread."""
        count = max(1, min(self.count, items))
        limits = [round(k * items / count) for k in range(count + 1)]
        own, *others = enumerate(itertools.pairwise(limits))
        running = [self._pool.submit(work, worker, *share) for worker, share in others]
        work(own[0], *own[1])
        for share in running:
            share.result()


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SliceMotion:
    """See the module docstring.

    Attributes:
        steps: (s, 3, 3, 6) change of a voxel index, along each axis, with ξ, for each entry of h.
    """

    steps: FloatArray

    @classmethod
    def of(cls, mm_from_pixel: FloatArray, index_from_mm: FloatArray) -> "SliceMotion":
        """From (s, 3, 3) mm from the centre of rotation, target frame; (3, 3) voxel steps of a mm step."""
        steps = np.zeros((len(mm_from_pixel), 3, 3, 6))
        # (P_k × Mᵀf)/ρ, row by row of the voxel axes
        place = mm_from_pixel.transpose(0, 2, 1)[:, :, None, :]
        steps[..., :3] = np.cross(place, index_from_mm) / HEART_RADIUS_MM
        steps[:, 2, :, 3:] = index_from_mm
        return cls(steps)

    def repeated(self, counts: IntArray) -> "SliceMotion":
        """Motion of parts that move as their slice does: `counts` (s,) of each slice."""
        return SliceMotion(np.repeat(self.steps, counts, axis=0))

    def gradient(self, sums: FloatArray) -> FloatArray:
        """(s, 6) Jᵀr of each slice, from the kernel's (s, STEP_SUMS)."""
        flat = self.steps.reshape(len(self.steps), FORCE, 6)
        return np.asarray((sums[:, None, :FORCE] @ flat)[:, 0])

    def matrix(self, sums: FloatArray) -> FloatArray:
        """(6, 6) JᵀJ of all slices together, from the kernel's (s, STEP_SUMS)."""
        flat = self.steps.reshape(len(self.steps), FORCE, 6)
        products = sums[:, _MATRIX].reshape(len(sums), FORCE, FORCE)
        return np.asarray((flat.transpose(0, 2, 1) @ products @ flat).sum(axis=0))


@dataclass(frozen=True, slots=True)
class Score:
    """similarity in [0, 1] (share of local ultrasound variance explained), overlap in [0, 1]."""

    similarity: float
    overlap: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Slope:
    """The score at a pose, and how it changes there, in the coordinates of `PoseChart`.

    Attributes:
        right: (6,) Jᵀr, half the gradient of Σ w·S.
        similarity, weight: S over all slices, and Σ w.
    """

    right: FloatArray
    similarity: float
    weight: float

    @property
    def left(self) -> float:
        """Σ w(1 − S), at least 1e-12."""
        return max(self.weight * (1.0 - self.similarity), 1e-12)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Quadratic model of Σ w(1 − S) in the coordinates of `PoseChart`, coefficients of the local fits fixed.

    Attributes:
        matrix: (6, 6) JᵀJ.
        slope: score and Jᵀr.
    """

    matrix: FloatArray
    slope: Slope


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class CostGradient:
    """LC2's cost of every slice, and its gradient over the pose.

    Attributes:
        cost: (s,) Σ w(1 − S) of each slice; weight: (s,) Σ w.
        gradient: (s, 6) of the cost in the coordinates of `PoseChart`, exact.
    """

    cost: FloatArray
    weight: FloatArray
    gradient: FloatArray


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
    ) -> None:
        """LC2 of a slice set against a model, at any pose.

        Args:
            slices, model: what is compared with what.
            patch_mm: edge of a patch; pitch_mm: of a pixel.
            density_width_mm: see `patches_of`.
            threads: of the caller, who closes them; without any all slices run on the calling thread.
        Raises:
            InvalidInputError: the model has one voxel only along an axis.
        """
        if min(model.grid.shape) < 2:
            raise InvalidInputError(
                f"the model is {model.grid.shape} voxels large; needed two or more along each axis"
            )
        self.slices = slices
        self._model = model
        self._threads = threads
        self._phases = model.nearest_phase(slices.model_phase)
        radius = max(2, round(patch_mm / pitch_mm / 2))
        pixels = pixel_runs(slices)
        self.patches = patches = patches_of(slices, pixels, radius, density_width_mm)
        self._slice_pixels = slices.masks.sum(axis=(1, 2)).astype(np.float64)
        self._patch_pixels = (2 * radius + 1) ** 2
        self._patched = PatchedSlices(
            pixels.values, pixels.first, pixels.runs, patches.first, patches.centers, patches.moments, radius
        )
        self._scratch = _scratch(
            self._patched, slices.masks.shape[2], 1 if threads is None else threads.count
        )
        self._index_from_mm = np.ascontiguousarray(np.linalg.inv(model.grid.axes_mm))
        self._channels = model.values.reshape(*model.values.shape[:3], -1)

    def per_slice(self, target_from_source: Rigid) -> FloatArray:
        """(s, 3) weighted score, weight and overlap of each slice."""
        return self._scores(self._placed(target_from_source)[0])

    def score(self, target_from_source: Rigid) -> Score:
        """Similarity and overlap of all slices together: overlap is the share of their pixels."""
        out = self.per_slice(target_from_source)
        inside = float(out[:, SLICE_OVERLAP] @ self._slice_pixels)
        return Score(_similarity(out), inside / max(1.0, float(self._slice_pixels.sum())))

    def similarity_at_shift(self, target_from_source: Rigid, shift: float) -> float:
        """Similarity if every slice belonged `shift` of a cycle later in the model's cycle than was taken."""
        model, _ = self._placed(target_from_source)
        phases = self._model.nearest_phase((self.slices.model_phase + shift) % 1.0)
        return _similarity(self._scores(model._replace(phases=phases)))

    def slope(self, target_from_source: Rigid, center_mm: FloatArray) -> Slope:
        """How the score changes with small motions about `center_mm` (3,), target frame."""
        sums, motion = self._step_sums(target_from_source, center_mm, matrix=False)
        return _slope(sums, motion)

    def normal_equations(self, target_from_source: Rigid, center_mm: FloatArray) -> NormalEquations:
        """`slope` with the matrix of Gauss–Newton, which takes half as much time again."""
        sums, motion = self._step_sums(target_from_source, center_mm, matrix=True)
        return NormalEquations(motion.matrix(sums), _slope(sums, motion))

    def cost_gradient(
        self, target_from_source: Rigid, center_mm: FloatArray, frame_from_pixel: FloatArray | None = None
    ) -> CostGradient:
        """Cost of each slice and its gradient in the coordinates of `PoseChart`.

        Args:
            frame_from_pixel: (s, 3, 3) where the slices lie; None: as in `SliceSet`.
        """
        sums, motion = self._step_sums(target_from_source, center_mm, frame_from_pixel, matrix=False)
        return _cost_gradient(sums, motion)

    def cut(self, owner: IntArray, part: IntArray) -> SliceParts:
        """The slices in parts; see `slice_parts`."""
        return slice_parts(self._patched, owner, part)

    def part_gradients(
        self, parts: SliceParts, poses: Sequence[Rigid], center_mm: FloatArray
    ) -> tuple[CostGradient, ...]:
        """As `cost_gradient` at each of some poses, of every part in place of every slice."""
        placed = [self._placed(pose) for pose in poses]
        model = placed[0][0]._replace(index_from_pixel=np.stack([at.index_from_pixel for at, _ in placed]))
        sums = np.empty((len(poses), parts.first_part[-1], MATRIX))
        ordered = np.empty_like(self._scratch.fits)
        self._run(lc2_step_parts, (self._patched, parts, model, self._scratch, ordered, sums))
        out, counts = [], np.diff(parts.first_part)
        for own, (_, mm_from_pixel) in zip(sums, placed, strict=True):
            motion = self._motion(mm_from_pixel, center_mm).repeated(counts)
            out.append(_cost_gradient(own, motion))
        return tuple(out)

    def shifted_part_gradient(
        self, parts: SliceParts, pose: Rigid, shift_mm: FloatArray, center_mm: FloatArray
    ) -> CostGradient:
        """As `part_gradients` at a pose relative to which each part is moved by (k, 3), target frame."""
        placed, mm_from_pixel = self._placed(pose)
        owner = np.repeat(np.arange(len(self.slices)), np.diff(parts.first_part))
        mm_from_pixel = mm_from_pixel[owner]
        mm_from_pixel[:, :, 2] += shift_mm
        index_from_pixel = np.ascontiguousarray(self._index_from_mm @ mm_from_pixel)
        model = placed._replace(phases=placed.phases[owner], index_from_pixel=index_from_pixel)
        sums = np.empty((len(owner), STEP_SUMS))
        self._run(lc2_step_slices, (parts.cut, model, self._scratch, False, sums), len(owner))
        return _cost_gradient(sums, self._motion(mm_from_pixel, center_mm))

    @property
    def information(self) -> float:
        """Number of independent observations that −n/2·log(1 − S) should count.

        Patches that fit into the slices without sharing pixels, over PATCHES_PER_OBSERVATION.
        """
        return len(self._patched.pixels) / self._patch_pixels / PATCHES_PER_OBSERVATION

    def _scores(self, model: PlacedModel) -> FloatArray:
        out = np.empty((len(self.slices), 3))
        self._run(lc2_slices, (self._patched, model, self._scratch, out))
        return out

    def _step_sums(
        self,
        target_from_source: Rigid,
        center_mm: FloatArray,
        frame_from_pixel: FloatArray | None = None,
        *,
        matrix: bool,
    ) -> tuple[FloatArray, SliceMotion]:
        """(s, STEP_SUMS) of `lc2_step_slices`, and what they mean for the pose."""
        model, mm_from_pixel = self._placed(target_from_source, frame_from_pixel)
        out = np.empty((len(self.slices), STEP_SUMS))
        self._run(lc2_step_slices, (self._patched, model, self._scratch, matrix, out))
        return out, self._motion(mm_from_pixel, center_mm)

    def _motion(self, mm_from_pixel: FloatArray, center_mm: FloatArray) -> SliceMotion:
        mm_from_pixel[:, :, 2] += self._model.grid.origin_mm - center_mm
        return SliceMotion.of(mm_from_pixel, self._index_from_mm)

    def _placed(
        self, target_from_source: Rigid, frame_from_pixel: FloatArray | None = None
    ) -> tuple[PlacedModel, FloatArray]:
        """The model at a pose, and (s, 3, 3) mm from its grid's origin from (column, row, 1)."""
        require_same_frame(self.slices.frame, target_from_source.source, "registration pose")
        require_same_frame(self._model.grid.frame, target_from_source.target, "registration pose")
        here = self.slices.frame_from_pixel if frame_from_pixel is None else frame_from_pixel
        mm_from_pixel = target_from_source.rotation @ here
        mm_from_pixel[:, :, 2] += target_from_source.translation_mm - self._model.grid.origin_mm
        index_from_pixel = np.ascontiguousarray(self._index_from_mm @ mm_from_pixel)
        return PlacedModel(self._channels, self._phases, index_from_pixel), mm_from_pixel

    def _run(self, kernel: Callable[..., Any], arguments: tuple[Any, ...], count: int | None = None) -> None:
        """A kernel over all slices, or over `count` parts of them."""
        total = len(self.slices) if count is None else count
        if self._threads is None:
            kernel(*arguments, 0, 0, total)
        else:
            self._threads.run(lambda *share: kernel(*arguments, *share), total)


def _scratch(slices: PatchedSlices, columns: int, workers: int) -> Scratch:
    """Memory of the kernels for `workers` workers."""
    edge, wide = 2 * slices.radius + 1, columns + 2 * slices.radius
    ends = np.concatenate([slices.runs[:, PIXEL], [len(slices.pixels)]])[slices.first_run]
    pixels, patches = (int(np.diff(first).max(initial=0)) for first in (ends, slices.first_patch))
    return Scratch(
        np.empty((workers, pixels, SUMS)),
        np.empty((workers, edge, wide, SUMS)),
        np.empty((workers, wide, SUMS)),
        np.empty((workers, patches, SUMS)),
    )


def _similarity(scores: FloatArray) -> float:
    """S of all slices together, from `per_slice`."""
    return float(scores[:, SLICE_SCORE].sum() / max(scores[:, SLICE_WEIGHT].sum(), 1e-300))


def _slope(sums: FloatArray, motion: SliceMotion) -> Slope:
    weight = max(float(sums[:, STEP_WEIGHT].sum()), 1e-300)
    return Slope(motion.gradient(sums).sum(axis=0), float(sums[:, STEP_SCORE].sum()) / weight, weight)


def _cost_gradient(sums: FloatArray, motion: SliceMotion) -> CostGradient:
    weight = sums[:, STEP_WEIGHT]
    return CostGradient(weight - sums[:, STEP_SCORE], weight, -2.0 * motion.gradient(sums))
