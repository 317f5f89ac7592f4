"""LC2's gradient block by block of space and slice by slice: what a sandwich covariance is made of.

Neighbouring patches share the difference between patient and pre-operative images, so that neither pixels nor
patches are independent observations; blocks of some centimetres nearly are. Every slice is cut into its
blocks, and their patches are evaluated as slices of their own.
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from dvf_ig.core import FloatArray, IntArray, Rigid, read_only_arrays
from dvf_ig.registration.distinct_rows import distinct_rows

from .density_weights import patch_centers_mm
from .lc2 import Lc2
from .patches import Patches
from .slices import SliceSet


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
        order = np.argsort(part.ravel(), kind="stable")
        counts = np.bincount(part.ravel(), minlength=len(keys))
        first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        centers = patches.centers[order]
        # patches stay centred on every second pixel, which the kernels rely on
        margin = metric.radius + metric.radius % 2
        corner = np.minimum.reduceat(centers, first[:-1], axis=0) - margin
        centers = centers - np.repeat(corner, counts, axis=0)
        self._parts = metric.with_patches(
            _cut(slices, keys[:, 0], corner, centers.max(axis=0) + metric.radius + 1, margin),
            Patches(first, centers, patches.moments[order]),
        )
        self.cell: IntArray = keys[:, 1:]
        self.slice: IntArray = keys[:, 0]

    def gradients(self, pose: Rigid, center_mm: FloatArray) -> BlockGradients:
        """Of every block at a pose."""
        found = self._parts.cost_gradient(pose, center_mm)
        return BlockGradients(found.cost, found.gradient)

    def shifted(self, shift_mm: FloatArray) -> "BlockedLc2":
        """The same blocks, each moved by (b, 3) in the slices' frame."""
        slices = self._parts.slices
        maps = slices.frame_from_pixel.copy()
        maps[:, :, 2] += shift_mm
        out = copy(self)
        out._parts = self._parts.with_patches(replace(slices, frame_from_pixel=maps), self._parts.patches)
        return out


def _cut(slices: SliceSet, owner: IntArray, corner: IntArray, size: IntArray, margin: int) -> SliceSet:
    """Windows of one size: of slice `owner` (b,) from row and column `corner` (b, 2) on, −margin at least."""
    rows, columns = (int(n) for n in size)
    pad = ((0, 0), (margin, rows), (margin, columns))
    images, masks = np.pad(slices.images, pad), np.pad(slices.masks, pad)
    row = margin + corner[:, 0, None, None] + np.arange(rows)[None, :, None]
    column = margin + corner[:, 1, None, None] + np.arange(columns)[None, None, :]
    number = owner[:, None, None]
    maps = slices.frame_from_pixel[owner].copy()
    maps[:, :, 2] += maps[:, :, 0] * corner[:, 1, None] + maps[:, :, 1] * corner[:, 0, None]
    bare = replace(slices, images=slices.images[:, :1, :1], masks=slices.masks[:, :1, :1])
    return replace(
        bare.subset(owner),
        images=np.ascontiguousarray(images[number, row, column]),
        masks=np.ascontiguousarray(masks[number, row, column]),
        frame_from_pixel=maps,
    )
