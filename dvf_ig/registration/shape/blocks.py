"""Costs of LC2 and of the boundary in blocks of space, on one scale, wherever blocks have been moved to.

Neighbouring patches share the difference between patient and pre-operative images, so that neither pixels nor
patches are independent observations; blocks of some centimetres nearly are.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import HEART_RADIUS_MM, FloatArray, IntArray, Rigid, read_only_arrays
from dvf_ig.kernels.boundary import RIGHT, SQUARES, SUMS, UNKNOWNS, OrientedPoints, boundary_step_sums
from dvf_ig.registration.boundary.fit import Boundary, BoundaryFitOptions, BoundaryProblem, normal_matrices
from dvf_ig.registration.lc2.lc2 import CostGradient, Lc2
from dvf_ig.registration.lc2.patches import patch_centers_mm
from dvf_ig.registration.pose_chart import PoseChart

POSE, SHIFT = slice(0, 6), slice(3, 6)
"""Parts of the unknowns: the six coordinates of `PoseChart`, its translation. The boundary's offset
follows."""
BLOCK_MM = 30.0
"""Edge of a block: with 20 mm the mean error on tuning hearts 1001–1008 is the same."""
STEP_MM = 1.0
"""Step of the differences of gradients that give a block's curvature."""
LC2_INFORMATION = 3.0
"""Information of a block, in units of `Lc2.information`, which counts its difference from the model as
noise as well."""
POINTS_PER_OBSERVATION = 10.0
"""Points of the boundary that count as one. Both are about a third of what counts if the change of shape is
not a part of the model; on tuning hearts 1009–1020 a boundary that counts three times as much is 0.05 mm
worse in calm images and 0.1 mm better in poor ones, both three times as much 0.03 mm worse and 0.05 mm
better."""
LC2_INFORMATION_OF_LABELS = 1.0
"""LC2_INFORMATION against the labels of a stack: LC2 sees the edges that the boundary sees, without their
offset. From 3 to 1 the mean error over the covered part stays 2.12 mm in 12 threshold hearts and goes from
1.42 to 1.21 mm in real stacks 002, 003, 008 and 009; χ² of the covariance falls in each of six looked at."""


def distinct_rows(rows: IntArray) -> tuple[IntArray, IntArray]:
    """Distinct rows in lexical order, and (n,) which of them each is.

    As `np.unique` along an axis, whose sort of rows keeps the interpreter from every other thread for 25 ms.
    """
    lowest = rows.min(axis=0)
    size = tuple((rows.max(axis=0) - lowest + 1).tolist())
    distinct, part = np.unique(np.ravel_multi_index(tuple((rows - lowest).T), size), return_inverse=True)
    return np.column_stack(np.unravel_index(distinct, size)) + lowest, part


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BlockGradients:
    """Cost and gradient of each block of each slice.

    Attributes:
        cost: (b,); gradient: (b, 6) in the coordinates of `PoseChart`.
    """

    cost: FloatArray
    gradient: FloatArray


class BlockedLc2:
    """LC2 of every block of every slice.

    Attributes:
        cell: (b, 3) which block of space, in steps of its edge in the slices' frame.
        slice: (b,) of which slice.
    """

    def __init__(self, metric: Lc2, *, block_mm: float) -> None:
        """Cut the slices of a metric.

        Args:
            block_mm: edge of a block of space.
        """
        slices, patches = metric.slices, metric.patches
        owner = np.repeat(np.arange(len(slices)), np.diff(patches.first))
        cell = np.floor(patch_centers_mm(slices, patches.first, patches.centers) / block_mm).astype(np.int64)
        keys, part = distinct_rows(np.column_stack([owner, cell]))
        self._metric, self._parts = metric, metric.cut(keys[:, 0], part.ravel())
        self.cell: IntArray = keys[:, 1:]
        self.slice: IntArray = keys[:, 0]

    def gradients(self, poses: Sequence[Rigid], center_mm: FloatArray) -> tuple[BlockGradients, ...]:
        """Gradients of every block at each pose; several poses at once cost less than one by one."""
        gradients = self._metric.part_gradients(self._parts, poses, center_mm)
        return tuple(BlockGradients(at.cost, at.gradient) for at in gradients)

    def shifted(self, pose: Rigid, shift_mm: FloatArray, center_mm: FloatArray) -> CostGradient:
        """Compute LC2 of every block at a pose relative to which each is moved by (b, 3), target frame."""
        return self._metric.shifted_part_gradient(self._parts, pose, shift_mm, center_mm)


class BlockedBoundary:
    """The boundary's points of every block of space.

    Attributes:
        cell: (n, 3) which block of space, in steps of its edge in the points' frame.
        offset_mm: of the surface, from which that of a state is counted.
    """

    def __init__(
        self, boundary: Boundary, offset_mm: float, center_mm: FloatArray, *, block_mm: float
    ) -> None:
        """Sort the points by their blocks.

        Args:
            offset_mm: of the boundary's fit.
            block_mm: edge of a block.
        """
        cells = np.floor(boundary.points.points_mm / block_mm).astype(np.int64)
        self.cell, group = distinct_rows(cells)
        order = np.argsort(group, kind="stable")
        sorted_points = Boundary(boundary.points.subset(order), boundary.target)
        self._problem = BoundaryProblem(sorted_points, center_mm)
        self._group: IntArray = group[order]
        self._ends = np.concatenate([[0], np.cumsum(np.bincount(group))]).tolist()
        self.offset_mm = offset_mm

    def expansion(self, pose: Rigid, shift_mm: FloatArray, offset_mm: float) -> tuple[FloatArray, FloatArray]:
        """(n, 7) gradient and (n, 7, 7) curvature of −log likelihood, one observation a point, at a pose.

        Args:
            shift_mm: (n, 3) by which each block is moved relative to the pose, target frame.
            offset_mm: of the surface, added to that of the fit.
        """
        problem = self._problem
        points = problem.points
        moved = points.points + (shift_mm @ pose.rotation)[self._group]
        moved.setflags(write=False)  # as the points of the whole boundary: one compiled kernel for both
        sums = np.empty((len(self.cell), SUMS))
        for out, begin, end in zip(sums, self._ends, self._ends[1:], strict=False):
            part = OrientedPoints(
                moved[begin:end],
                points.normals[begin:end],
                points.weights[begin:end],
                points.phases[begin:end],
            )
            boundary_step_sums(
                part,
                problem.splines,
                pose.matrix[:3],
                problem.center_mm,
                HEART_RADIUS_MM,
                self.offset_mm + offset_mm,
                BoundaryFitOptions().sigmas_mm[-1],
                out,
            )
        curvature = normal_matrices(sums)
        variance = float(sums[:, SQUARES].sum()) / max(float(curvature[:, 6, 6].sum()), 1e-12)
        scale = 1.0 / max(variance, 1e-12)
        return scale * sums[:, RIGHT : RIGHT + UNKNOWNS], scale * curvature


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BlockCosts:
    """−log likelihood of blocks of space, to second order about one pose.

    Attributes:
        gradient: (n, 7); curvature: (n, 7, 7), none negative.
    """

    gradient: FloatArray
    curvature: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Influences:
    """Gradients of the parts of blocks, each seen in one slice or by the boundary: a sandwich's terms.

    Attributes:
        gradient: (g, 7) of −log likelihood over pose and boundary's offset.
        block: (g,) which block each belongs to.
        slice: (g,) which slice, −1 of the boundary.
    """

    gradient: FloatArray
    block: IntArray
    slice: IntArray


class BlockedMatch:
    """LC2 and boundary of every block of space.

    LC2's curvature is that at the first pose: where blocks have moved on, only gradients are computed again.

    Attributes:
        cell: (n, 3) which block, in steps of BLOCK_MM in the source frame.
        curvature: (6, 6) of −log likelihood of all of LC2 together, counted as `Lc2.information` does.
    """

    def __init__(
        self,
        lc2: BlockedLc2,
        information: float,
        boundary: BlockedBoundary | None,
        chart: PoseChart,
        of_block: float = LC2_INFORMATION,
    ) -> None:
        """Expand LC2 about the pose of a chart.

        Args:
            information: number of observations in −n/2·log(1 − S) of all slices.
            of_block: LC2_INFORMATION, or that of labels.
        """
        self._lc2, self._boundary, self._center_mm = lc2, boundary, chart.center_mm
        cells = lc2.cell if boundary is None else np.vstack([lc2.cell, boundary.cell])
        self.cell, block = distinct_rows(cells)
        self._of_lc2, self._of_boundary = block[: len(lc2.cell)], block[len(lc2.cell) :]
        here, change = _expansion(lc2, chart)
        self._scale = of_block * information / (2.0 * max(float(here.cost.sum()), 1e-12))
        own = np.zeros((len(self.cell), 6, 6))
        np.add.at(own, self._of_lc2, self._scale * change)
        self._lc2_curvature = none_negative(own)
        whole = self._scale / of_block * change.sum(axis=0)
        self.curvature: FloatArray = 0.5 * (whole + whole.T)

    def __len__(self) -> int:
        return len(self.cell)

    def places_mm(self, pose: Rigid) -> FloatArray:
        """(n, 3) middles of the blocks at a pose, target frame."""
        return pose.apply_array((self.cell.astype(np.float64) + 0.5) * BLOCK_MM)

    def similarity_expansion(self, pose: Rigid, shift_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 3) gradient and (n, 3, 3) curvature of LC2's −log likelihood by a displacement of every block.

        Args:
            shift_mm: (n, 3) by which each block is displaced at a pose already, target frame.
        """
        of_slices = self._lc2.shifted(pose, shift_mm[self._of_lc2], self._center_mm).gradient[:, SHIFT]
        gradient = np.zeros((len(self), 3))
        np.add.at(gradient, self._of_lc2, self._scale * of_slices)
        return gradient, self._lc2_curvature[:, SHIFT, SHIFT]

    def costs(self, pose: Rigid, shift_mm: FloatArray, offset_mm: float) -> tuple[BlockCosts, Influences]:
        """To second order about a pose and a displacement of every block.

        Args:
            shift_mm: (n, 3) of the blocks, target frame.
            offset_mm: of the boundary's surface, relative to that of its fit.
        """
        of_lc2 = self._scale * self._lc2.shifted(pose, shift_mm[self._of_lc2], self._center_mm).gradient
        gradient = np.hstack([of_lc2, np.zeros((len(of_lc2), 1))])
        curvature = np.zeros((len(self), UNKNOWNS, UNKNOWNS))
        curvature[:, POSE, POSE] = self._lc2_curvature
        number = self._lc2.slice
        if self._boundary is not None:
            slope, bend = self._boundary.expansion(pose, shift_mm[self._of_boundary], offset_mm)
            gradient = np.vstack([gradient, slope / POINTS_PER_OBSERVATION])
            curvature[self._of_boundary] += bend / POINTS_PER_OBSERVATION
            number = np.concatenate([number, np.full(len(slope), -1, dtype=np.int64)])
        block = np.concatenate([self._of_lc2, self._of_boundary])
        summed = np.zeros((len(self), UNKNOWNS))
        np.add.at(summed, block, gradient)
        return BlockCosts(summed, curvature), Influences(gradient, block, number)


def about_no_shift(costs: BlockCosts, shift_mm: FloatArray) -> BlockCosts:
    """Move the gradient of an expansion to blocks that are not shifted relative to the pose."""
    gradient = costs.gradient - np.einsum("bud,bd->bu", costs.curvature[:, :, SHIFT], shift_mm)
    return BlockCosts(gradient, costs.curvature)


def _expansion(lc2: BlockedLc2, chart: PoseChart) -> tuple[BlockGradients, FloatArray]:
    """Cost and gradient at the chart's pose, and (b, 6, 6) change of the gradient with the pose."""
    steps = STEP_MM * np.vstack([np.eye(6), -np.eye(6)])
    here, *moved = lc2.gradients([chart.base, *(chart.pose(step) for step in steps)], chart.center_mm)
    gradient = np.stack([at.gradient for at in moved], axis=1)
    return here, (gradient[:, :6] - gradient[:, 6:]) / (2.0 * STEP_MM)


def none_negative(curvature: FloatArray) -> FloatArray:
    """(n, k, k) symmetric matrices without their negative parts."""
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.transpose(0, 2, 1)))
    return np.asarray((vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1))
