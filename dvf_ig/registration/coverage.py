"""The part of a heart that its pre-operative images cover, where they end within it.

A short-axis stack ends below the atria and often above the apex. Beyond its ends nothing is known: what a
sweep shows there is evidence neither for nor against a pose. What lies far from the heart is left out as
well: with slices 10 mm apart it pulls the pose aside by more than the heart holds it.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from dvf_ig.core import BoolArray, FloatArray, Grid, Points, Rigid, VolumeSeries, read_only_arrays

from .evidence.assessment import OF_STACK, OF_STACK_AND_VIEWS
from .lc2.slices import SliceSet

RIM_MM = 5.0
"""Width around the heart that is compared: with real stacks 002 and 003 LC2 of labels, begun at the truth,
ends 1.4 and 1.6 mm from it with 5 mm, 1.9 and 1.9 with 8 mm, 1.6 and 1.9 with 2 mm."""
CELL_MM = 8.0
"""Edge of the cells in which a sweep's pixels and the heart's surface are compared."""
MOSTLY = 0.4
"""Component of a direction from which on it is named."""
TOWARDS = (("right", "left"), ("front", "back"), ("feet", "head"))
"""Ends of the axes of LPS, lower and upper."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Share of the covered part of a heart that a sweep images.

    Attributes:
        share: of the points on its surface, 0 to 1.
        missing_mm: (3,) middle of what is not imaged, in the model's frame; NaN if nothing is missing.
        surface_mm: (k, 3) points on the surface of the covered part.
        views: whether long-axis views show the heart beyond the ends of a stack.
    """

    share: float
    missing_mm: FloatArray
    surface_mm: FloatArray
    views: bool = False

    @property
    def advice(self) -> str:
        """Where to image, as a user reads it."""
        seen = f"the sweep images {100 * self.share:.0f} % of the part of the heart that the MR covers"
        if not np.isfinite(self.missing_mm).all():
            return seen
        x, y, z = self.missing_mm
        away = self.missing_mm - self.surface_mm.mean(axis=0)
        away = away / max(float(np.linalg.norm(away)), 1e-12)
        words = [ends[int(part > 0)] for part, ends in zip(away, TOWARDS, strict=True) if abs(part) > MOSTLY]
        side = f" towards the patient's {' and '.join(words)}" if words else ""
        return f"{seen}; image more of it{side}, about ({x:.0f}, {y:.0f}, {z:.0f}) mm of the MR"


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class CoveredPart:
    """Part of a heart that pre-operative images cover, where they end within the heart.

    Attributes:
        grid: of `compared_voxels`, which ends where the images do.
        compared_voxels: (nx, ny, nz) of the heart at any phase and RIM_MM around it.
        surface_mm: (k, 3) points of the heart's surface at end-diastole within the images.
        views: whether long-axis views show the heart beyond the ends of a stack.
    """

    grid: Grid
    compared_voxels: BoolArray
    surface_mm: FloatArray
    views: bool = False

    @property
    def kind(self) -> str:
        """Ending of the kind of images by which the evidence was calibrated."""
        return OF_STACK_AND_VIEWS if self.views else OF_STACK

    @property
    def surface(self) -> Points:
        """Points on the covered surface, over which the stated error is."""
        return Points(self.grid.frame, self.surface_mm)

    def compared(self, slices: SliceSet, pose: Rigid) -> SliceSet:
        """The slices without the pixels that lie outside the covered part at a pose."""
        rows, columns = slices.images.shape[1:]
        column, row = np.meshgrid(np.arange(columns, dtype=np.float32), np.arange(rows, dtype=np.float32))
        pixels = np.stack([column.ravel(), row.ravel(), np.ones(rows * columns, dtype=np.float32)])
        index_from_mm = np.linalg.inv(self.grid.axes_mm)
        rotation = index_from_mm @ pose.rotation
        offset = index_from_mm @ (pose.translation_mm - self.grid.origin_mm) + 0.5
        padded = np.pad(self.compared_voxels, 1)
        last = np.array(padded.shape)[:, None] - 1
        masks = slices.masks.copy()
        for mask, frame_from_pixel in zip(masks, slices.frame_from_pixel, strict=True):
            index_from_pixel = rotation @ frame_from_pixel
            index_from_pixel[:, 2] += offset
            index = np.floor(index_from_pixel.astype(np.float32) @ pixels).astype(np.int32) + 1
            i, j, k = np.clip(index, 0, last)
            mask &= padded[i, j, k].reshape(rows, columns)
        return replace(slices, images=np.where(masks, slices.images, np.float32(0)), masks=masks)

    def holds(self, points_mm: FloatArray) -> BoolArray:
        """(n,) whether (n, 3) points in the model's frame lie in the covered part."""
        index = self.grid.to_index(points_mm)
        return np.asarray(self.grid.holds(index) & self.compared_voxels[self.grid.nearest(index)])

    def extended(self, labels: VolumeSeries, known: BoolArray) -> "CoveredPart":
        """The covered part with what long-axis views show beyond the ends of a stack.

        Its surface, of which a sweep is to image enough, remains that of the stack.

        Args:
            labels: of stack and views; known: (nx, ny, nz) their voxels that an image shows.
        """
        return CoveredPart(labels.grid, _near_heart(labels) & known, self.surface_mm, views=True)

    def imaged_by(self, slices: SliceSet, pose: Rigid) -> Coverage:
        """Share of the surface near which slices have pixels at a pose."""
        seen = _cells_of(slices, pose)
        points = np.floor(self.surface_mm / CELL_MM).astype(np.int64)
        hit = np.array([tuple(cell) in seen for cell in points.tolist()])
        return Coverage(
            float(hit.mean()),
            np.full(3, np.nan) if hit.all() else self.surface_mm[~hit].mean(axis=0),
            self.surface_mm,
            self.views,
        )


def ends_within(images: Grid, surface_mm: FloatArray) -> bool:
    """Return whether images end within a heart: they hold some of its surface, and not all.

    Args:
        surface_mm: (n, 3) vertices of the heart's surface at end-diastole, in the images' frame.
    """
    inside = images.holds(images.to_index(surface_mm))
    return bool(inside.any() and not inside.all())


def covered_part(labels: VolumeSeries, surface_mm: FloatArray, shown: BoolArray | None = None) -> CoveredPart:
    """The covered part of a heart.

    Args:
        labels: of the heart at every phase (0 outside), on a grid that ends where the images do.
        surface_mm: as for `ends_within`.
        shown: (n, nx, ny, nz) voxels in which labels are known, at each phase; compared is what always is.
    """
    grid = labels.grid
    inside = surface_mm[grid.holds(grid.to_index(surface_mm))]
    _, first = np.unique(np.floor(inside / (0.5 * CELL_MM)), axis=0, return_index=True)
    compared = _near_heart(labels)
    return CoveredPart(grid, compared if shown is None else compared & shown.all(axis=0), inside[first])


def _near_heart(labels: VolumeSeries) -> BoolArray:
    heart = (labels.values != 0).any(axis=0)
    outside_mm = ndimage.distance_transform_edt(~heart, sampling=labels.grid.spacing_mm)
    return np.asarray(outside_mm <= RIM_MM)


def _cells_of(slices: SliceSet, pose: Rigid) -> set[tuple[int, ...]]:
    """Cells of the target frame that hold a pixel of the slices."""
    owner, row, column = np.nonzero(slices.masks)
    pixel = np.column_stack([column, row, np.ones(len(row))])
    source = np.einsum("nij,nj->ni", slices.frame_from_pixel[owner], pixel)
    cells = np.unique(np.floor(pose.apply_array(source) / CELL_MM).astype(np.int64), axis=0)
    return {tuple(cell) for cell in cells.tolist()}
