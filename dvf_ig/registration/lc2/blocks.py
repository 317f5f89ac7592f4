"""LC2's gradient block by block of space and slice by slice: what a sandwich covariance is made of.

Neighbouring patches share the difference between patient and pre-operative images, so that neither pixels nor
patches are independent observations; blocks of some centimetres nearly are.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, IntArray, Rigid, read_only_arrays
from dvf_ig.registration.distinct_rows import distinct_rows

from .density_weights import patch_centers_mm
from .lc2 import Lc2


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
        """Of every block at each pose; poses that lie together cost less than one by one."""
        found = self._metric.part_gradients(self._parts, poses, center_mm)
        return tuple(BlockGradients(at.cost, at.gradient) for at in found)

    def shifted_gradient(self, pose: Rigid, shift_mm: FloatArray, center_mm: FloatArray) -> FloatArray:
        """(b, 6) as `gradients` at a pose beside which each block is moved by (b, 3), target frame."""
        return self._metric.shifted_part_gradient(self._parts, pose, shift_mm, center_mm).gradient
