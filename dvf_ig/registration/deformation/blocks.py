"""What LC2 and the boundary say of each block of space, on one scale."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, IntArray, read_only_arrays
from dvf_ig.kernels.boundary import UNKNOWNS
from dvf_ig.registration.boundary.blocks import BoundaryBlocks
from dvf_ig.registration.distinct_rows import distinct_rows
from dvf_ig.registration.lc2.blocks import BlockedLc2, BlockGradients
from dvf_ig.registration.pose_chart import PoseChart

from .joint_fit import POSE, BlockCosts, none_negative

BLOCK_MM = 30.0
"""Edge of a block: with 20 mm the mean error on tuning hearts 1001–1008 is the same."""
STEP_MM = 1.0
"""Of the differences of gradients that give a block's curvature."""
LC2_INFORMATION = 3.0
"""Of a block, in units of `Lc2.information`, which counts its difference from the model as noise as well."""
POINTS_PER_OBSERVATION = 10.0
"""Of the boundary. Both are about a third of what counts where the change of shape is not a part of the
model; on tuning hearts 1001–1008 twice or four times as much changes the mean error by less than 0.02 mm,
a boundary that counts 3, 10 or 30 times as much by 0.05 mm at most, with labels or a model alone as well."""
OFFSET_SIGMA_MM = 1.0
"""Of the boundary's uniform offset about that of its fit."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Costs of blocks, and the gradients that they are sums of.

    Attributes:
        costs: of the blocks.
        curvature: (6, 6) of −log likelihood of all of LC2 together, counted as `Lc2.information` does.
        gradient: (g, 7) of each part of a block, the slices' and the boundary's.
        block: (g,) which block each belongs to.
        slice: (g,) which slice, −1 of the boundary.
    """

    costs: BlockCosts
    curvature: FloatArray
    gradient: FloatArray
    block: IntArray
    slice: IntArray


def blocks_at(
    lc2: BlockedLc2,
    information: float,
    boundary: BoundaryBlocks | None,
    chart: PoseChart,
) -> Blocks:
    """Costs about the pose of a chart.

    Args:
        information: number of observations in −n/2·log(1 − S) of all slices.
    """
    here, change = _expansion(lc2, chart)
    scale = LC2_INFORMATION * information / (2.0 * max(float(here.cost.sum()), 1e-12))
    gradient = _widened(scale * here.gradient)
    cells, slices = lc2.cell, lc2.slice
    if boundary is not None:
        per_point = 1.0 / POINTS_PER_OBSERVATION
        gradient = np.vstack([gradient, per_point * boundary.gradient])
        cells = np.vstack([cells, boundary.cell])
        slices = np.concatenate([slices, np.full(len(boundary.cell), -1, dtype=np.int64)])
    keys, block = distinct_rows(cells)
    summed, curvature = np.zeros((len(keys), UNKNOWNS)), np.zeros((len(keys), UNKNOWNS, UNKNOWNS))
    np.add.at(summed, block, gradient)
    own = np.zeros((len(keys), 6, 6))
    np.add.at(own, block[: len(change)], scale * change)
    curvature[:, POSE, POSE] = none_negative(own)
    if boundary is not None:
        np.add.at(curvature, block[len(change) :], per_point * boundary.curvature)
    places = chart.base.apply_array((keys.astype(np.float64) + 0.5) * BLOCK_MM)
    whole = scale / LC2_INFORMATION * change.sum(axis=0)
    costs = BlockCosts(places, summed, curvature)
    return Blocks(costs, 0.5 * (whole + whole.T), gradient, block, slices)


def _expansion(lc2: BlockedLc2, chart: PoseChart) -> tuple[BlockGradients, FloatArray]:
    """Cost and gradient at the chart's pose, and (b, 6, 6) change of the gradient with the pose."""
    steps = STEP_MM * np.vstack([np.eye(6), -np.eye(6)])
    here, *moved = lc2.gradients([chart.base, *(chart.pose(step) for step in steps)], chart.center_mm)
    gradient = np.stack([at.gradient for at in moved], axis=1)
    return here, (gradient[:, :6] - gradient[:, 6:]) / (2.0 * STEP_MM)


def _widened(gradient: FloatArray) -> FloatArray:
    return np.hstack([gradient, np.zeros((len(gradient), 1))])
