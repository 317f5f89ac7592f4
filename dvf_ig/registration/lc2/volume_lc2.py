"""LC2 of a 3-D ultrasound image with cubic patches, against channels of one or several images."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import HEART_RADIUS_MM, BoolArray, FloatArray, Grid, IntArray, Rigid, read_only_arrays
from dvf_ig.kernels.lc2.blocks import (
    BLOCK_COLUMNS,
    BLOCK_MOMENT,
    BLOCK_STIFFNESS,
    CORNERS,
    BlockedVoxels,
    fit_patches,
    force_blocks,
    sample_blocks,
    sum_count,
)

from .lc2 import NormalEquations, Score, SliceThreads, Slope

MIN_FILL = 0.5
"""Least share of a patch that must be insonified."""
FLAT = 1e-8
"""Variance below which a patch of ultrasound carries nothing to explain."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class VolumeChannels:
    """Channels by which LC2 explains the ultrasound.

    Attributes:
        grid: where the channels lie.
        values: (nx, ny, nz, c) float32, each of zero mean and unit variance.
    """

    grid: Grid
    values: NDArray[np.float32]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Insonified voxels sorted by blocks, and the patches that blocks form.

    Attributes:
        grid: of the ultrasound.
        voxels: for the kernels, which need writable arrays.
        weights: (p,) of each patch: the standard deviation of its ultrasound.
        centers_mm: (p, 3) mean place of the voxels of each patch, source frame.
    """

    grid: Grid
    voxels: BlockedVoxels
    weights: FloatArray
    centers_mm: FloatArray


def blocks_of(values: NDArray[np.float32], grid: Grid, edge: int) -> Blocks:
    """Cut a volume into blocks of edge³ voxels, and pair them to patches of 2·edge.

    Args:
        values: (nx, ny, nz), NaN where nothing was insonified.
    """
    index: IntArray = np.argwhere(np.isfinite(values)).astype(np.int64)
    shape = tuple(int(n) // edge + 1 for n in values.shape)
    key: IntArray = np.ravel_multi_index(tuple((index // edge).T), shape)
    order = np.argsort(key, kind="stable")
    index, key = index[order], key[order]
    u = values[tuple(index.T)]
    keys, first = np.unique(key, return_index=True)
    first = np.append(first, len(key)).astype(np.int64)
    number: IntArray = np.full(shape, -1, dtype=np.int64)
    number.ravel()[keys] = np.arange(len(keys))
    number = np.pad(number, ((0, 1),) * 3, constant_values=-1)
    low = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1).reshape(-1, 3)
    steps = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3)
    members = np.stack([number[tuple((low + step).T)] for step in steps], axis=1)
    count = np.diff(first).astype(np.float64)
    sums = np.stack(
        [count, *(np.add.reduceat(column, first[:-1]) for column in (u.astype(float), u.astype(float) ** 2))]
        + [np.add.reduceat(index[:, a].astype(float), first[:-1]) for a in range(3)],
        axis=1,
    )
    sums = np.vstack([sums, np.zeros(6)])  # block −1
    total = sums[members].sum(axis=1)
    full = total[:, 0] >= MIN_FILL * CORNERS * edge**3
    members, total = members[full], total[full]
    mean = total[:, 1] / total[:, 0]
    variance = total[:, 2] / total[:, 0] - mean**2
    varies = variance > FLAT
    members, total, mean, variance = members[varies], total[varies], mean[varies], variance[varies]
    of_block = np.full((len(keys), CORNERS), -1, dtype=np.int64)
    for corner in range(CORNERS):
        there = members[:, corner] >= 0
        of_block[members[there, corner], corner] = np.flatnonzero(there)
    voxels = BlockedVoxels(
        index.astype(np.float32),
        u.astype(np.float32),
        first,
        np.ascontiguousarray(members),
        of_block,
        np.column_stack([1.0 / total[:, 0], mean, variance]),
    )
    return Blocks(grid, voxels, np.sqrt(variance), grid.to_mm(total[:, 3:] / total[:, :1]))


class VolumeLc2:
    """Scores a pose. Holds scratch memory, so one instance serves one thread of Python.

    Source: Wein 2013, eq. 3–5, with 3-D patches as in its first form, any number of channels, and an exact
    gradient.
    """

    def __init__(self, blocks: Blocks, model: VolumeChannels, threads: SliceThreads) -> None:
        """All patches take part; see `restricted`."""
        self._blocks, self._model, self._threads = blocks, model, threads
        self._channels = np.array(model.values)  # writable, as the kernels are compiled for
        n, b, p = len(blocks.voxels.u), len(blocks.voxels.first) - 1, len(blocks.weights)
        c = model.values.shape[3]
        self._values = np.empty((n, c), dtype=np.float32)
        self._gradients = np.empty((n, c, 3), dtype=np.float32)
        self._sums = np.zeros((b, sum_count(c) + 1))
        self._forces = np.zeros((b, BLOCK_COLUMNS))
        self._scores, self._coefficients = np.zeros(p), np.zeros((p, sum_count(c)))
        self._index_from_mm = np.linalg.inv(model.grid.axes_mm)
        self._use(blocks.weights)

    @property
    def grid(self) -> Grid:
        """Grid of the ultrasound."""
        return self._blocks.grid

    @property
    def centers_mm(self) -> FloatArray:
        """(p, 3) mean place of the voxels of each patch, source frame."""
        return self._blocks.centers_mm

    @property
    def model(self) -> VolumeChannels:
        return self._model

    def against(self, model: VolumeChannels) -> "VolumeLc2":
        """LC2 of this ultrasound against another model with as many channels; shares scratch memory."""
        other = object.__new__(VolumeLc2)
        other.__dict__.update(self.__dict__)
        other._model, other._channels = model, np.array(model.values)
        other._index_from_mm = np.linalg.inv(model.grid.axes_mm)
        return other

    def _use(self, weights: FloatArray) -> None:
        self._weights = np.array(weights)
        members = self._blocks.voxels.block_of_patch[self._weights > 0]
        self._active: IntArray = np.unique(members[members >= 0]).astype(np.int64)

    def restricted(self, patches: BoolArray) -> "VolumeLc2":
        """LC2 on some of the patches (p,) alone; shares scratch memory."""
        other = object.__new__(VolumeLc2)
        other.__dict__.update(self.__dict__)
        other._use(np.where(patches, self._blocks.weights, 0.0))
        return other

    def score(self, target_from_source: Rigid) -> Score:
        """Similarity, and share of the voxels inside the model's volume."""
        self._fit(target_from_source, slopes=False)
        first = self._blocks.voxels.first
        voxels = float((first[self._active + 1] - first[self._active]).sum())
        inside = float(self._sums[self._active, -1].sum()) / max(voxels, 1.0)
        return Score(float(self._weights @ self._scores / max(self._weights.sum(), 1e-300)), inside)

    def patch_scores(self, target_from_source: Rigid) -> FloatArray:
        """(p,) S of every patch; 0 of those that take no part."""
        self._fit(target_from_source, slopes=False)
        return self._scores.copy()

    def normal_equations(self, target_from_source: Rigid, center_mm: FloatArray) -> NormalEquations:
        """How the score changes with small motions about `center_mm` (3,), target frame."""
        matrix = self._fit(target_from_source, slopes=True)
        self._run(
            force_blocks,
            (
                self._blocks.voxels,
                matrix,
                self._active,
                self._values,
                self._gradients,
                self._coefficients,
                self._forces,
            ),
            len(self._active),
        )
        rows = self._forces[self._active]
        weight = float(self._weights.sum())
        right = self._wrench(rows.sum(axis=0), center_mm)
        curvature = self._stiffness(rows, center_mm)
        return NormalEquations(curvature, Slope(right, float(self._weights @ self._scores) / weight, weight))

    def slope(self, target_from_source: Rigid, center_mm: FloatArray) -> Slope:
        """`normal_equations` without the matrix, at the same cost."""
        return self.normal_equations(target_from_source, center_mm).slope

    def _run(self, kernel: Callable[..., object], arguments: tuple[object, ...], items: int) -> None:
        """A kernel over all of `items`, whatever thread it is on."""
        self._threads.run(lambda _, begin, end: kernel(*arguments, begin, end), items)

    @property
    def information(self) -> float:
        """Number of patches that share no voxel."""
        return float((self._weights > 0).sum()) / CORNERS

    def _wrench(self, total: FloatArray, center_mm: FloatArray) -> FloatArray:
        """(6,) half the derivative of Σ w·S over rotation (mm at the radius) and translation."""
        grid = self._model.grid
        force = total[:BLOCK_MOMENT] @ self._index_from_mm
        moment = grid.axes_mm @ total[BLOCK_MOMENT:BLOCK_STIFFNESS].reshape(3, 3) @ self._index_from_mm
        moment += np.outer(grid.origin_mm - center_mm, force)
        turn = np.array(
            [moment[1, 2] - moment[2, 1], moment[2, 0] - moment[0, 2], moment[0, 1] - moment[1, 0]]
        )
        return np.concatenate([turn / HEART_RADIUS_MM, force])

    def _stiffness(self, rows: FloatArray, center_mm: FloatArray) -> FloatArray:
        """(6, 6) JᵀJ with the coefficients of the fits fixed; all voxels of a block count as at its first."""
        local = rows[:, BLOCK_STIFFNESS:][:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
        motion = np.zeros((len(rows), 3, 6))
        motion[:, :, 3:] = np.eye(3)
        x, y, z = ((self._corners_mm - center_mm) / HEART_RADIUS_MM).T
        motion[:, 0, 1], motion[:, 0, 2] = z, -y
        motion[:, 1, 0], motion[:, 1, 2] = -z, x
        motion[:, 2, 0], motion[:, 2, 1] = y, -x
        motion = self._index_from_mm @ motion
        return np.asarray(motion.reshape(-1, 6).T @ (local @ motion).reshape(-1, 6))

    def _fit(self, target_from_source: Rigid, *, slopes: bool) -> FloatArray:
        """Sample and fit at a pose; returns (3, 4) model index from ultrasound index."""
        source = self._blocks.grid
        linear = self._index_from_mm @ target_from_source.rotation @ source.axes_mm
        origin = target_from_source.apply_array(source.origin_mm) - self._model.grid.origin_mm
        matrix = np.column_stack([linear, self._index_from_mm @ origin])
        voxels = self._blocks.voxels
        first = voxels.first[self._active]
        self._corners_mm = target_from_source.apply_array(
            source.to_mm(voxels.place[first].astype(np.float64))
        )
        self._run(
            sample_blocks,
            (voxels, self._channels, matrix, self._active, slopes, self._values, self._gradients, self._sums),
            len(self._active),
        )
        self._run(
            fit_patches,
            (voxels, self._weights, self._sums, self._scores, self._coefficients),
            len(self._weights),
        )
        return matrix
