"""What LC2 and the boundary say of each block of space, on one scale, wherever blocks have been moved to."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, IntArray, Rigid, read_only_arrays
from dvf_ig.kernels.boundary import UNKNOWNS
from dvf_ig.registration.boundary.blocks import BlockedBoundary
from dvf_ig.registration.distinct_rows import distinct_rows
from dvf_ig.registration.lc2.blocks import BlockedLc2, BlockGradients
from dvf_ig.registration.pose_chart import PoseChart

from .joint_fit import POSE, SHIFT, BlockCosts, none_negative

BLOCK_MM = 30.0
"""Edge of a block: with 20 mm the mean error on tuning hearts 1001–1008 is the same."""
STEP_MM = 1.0
"""Of the differences of gradients that give a block's curvature."""
LC2_INFORMATION = 3.0
"""Of a block, in units of `Lc2.information`, which counts its difference from the model as noise as well."""
POINTS_PER_OBSERVATION = 10.0
"""Of the boundary. Both are about a third of what counts where the change of shape is not a part of the
model; on tuning hearts 1009–1020 a boundary that counts three times as much is 0.05 mm worse in calm images
and 0.1 mm better in poor ones, both three times as much 0.03 mm worse and 0.05 mm better."""


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

    LC2's curvature is that at the first pose: where blocks have moved on, only gradients are taken anew.

    Attributes:
        cell: (n, 3) which block, in steps of BLOCK_MM in the source frame.
        curvature: (6, 6) of −log likelihood of all of LC2 together, counted as `Lc2.information` does.
    """

    def __init__(
        self, lc2: BlockedLc2, information: float, boundary: BlockedBoundary | None, chart: PoseChart
    ) -> None:
        """Expand LC2 about the pose of a chart.

        Args:
            information: number of observations in −n/2·log(1 − S) of all slices.
        """
        self._lc2, self._boundary, self._center_mm = lc2, boundary, chart.center_mm
        cells = lc2.cell if boundary is None else np.vstack([lc2.cell, boundary.cell])
        self.cell, block = distinct_rows(cells)
        self._of_lc2, self._of_boundary = block[: len(lc2.cell)], block[len(lc2.cell) :]
        here, change = _expansion(lc2, chart)
        self._scale = LC2_INFORMATION * information / (2.0 * max(float(here.cost.sum()), 1e-12))
        own = np.zeros((len(self.cell), 6, 6))
        np.add.at(own, self._of_lc2, self._scale * change)
        self._lc2_curvature = none_negative(own)
        whole = self._scale / LC2_INFORMATION * change.sum(axis=0)
        self.curvature: FloatArray = 0.5 * (whole + whole.T)

    def __len__(self) -> int:
        return len(self.cell)

    def places_mm(self, pose: Rigid) -> FloatArray:
        """(n, 3) middles of the blocks at a pose, target frame."""
        return pose.apply_array((self.cell.astype(np.float64) + 0.5) * BLOCK_MM)

    def costs(self, pose: Rigid, shift_mm: FloatArray, offset_mm: float) -> tuple[BlockCosts, Influences]:
        """To second order about a pose and a displacement of every block.

        Args:
            shift_mm: (n, 3) of the blocks, target frame.
            offset_mm: of the boundary's surface, beside that of its fit.
        """
        found = self._scale * self._lc2.shifted_gradient(pose, shift_mm[self._of_lc2], self._center_mm)
        gradient = np.hstack([found, np.zeros((len(found), 1))])
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
    """The same expansion, its gradient where blocks are not moved beside the pose."""
    gradient = costs.gradient - np.einsum("bud,bd->bu", costs.curvature[:, :, SHIFT], shift_mm)
    return BlockCosts(gradient, costs.curvature)


def _expansion(lc2: BlockedLc2, chart: PoseChart) -> tuple[BlockGradients, FloatArray]:
    """Cost and gradient at the chart's pose, and (b, 6, 6) change of the gradient with the pose."""
    steps = STEP_MM * np.vstack([np.eye(6), -np.eye(6)])
    here, *moved = lc2.gradients([chart.base, *(chart.pose(step) for step in steps)], chart.center_mm)
    gradient = np.stack([at.gradient for at in moved], axis=1)
    return here, (gradient[:, :6] - gradient[:, 6:]) / (2.0 * STEP_MM)
