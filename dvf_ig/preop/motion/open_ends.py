"""What an image shows of an organ's surface: borders within the organ, and the part that slices show."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, Grid, SeenPart, read_only_arrays

from .base_descent import BaseDescent, towards_base

GAP_MM = 18.0
"""Largest distance of slices between which the surface counts as known: stacks are made every 8 to 18 mm."""
HALF_SLICE_MM = 2.0
"""How far a slice shows the surface on either side of its middle: slices are 6 to 10 mm thick."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class OpenEnd:
    """Border of the image that the organ reaches.

    Attributes:
        axis: axis of the grid across the border.
        index: the last slice that shows the organ there.
        position_mm: (3,) middle of the organ in it.
        outward: (3,) unit normal away from the image.
    """

    axis: int
    index: int
    position_mm: FloatArray
    outward: FloatArray

    @property
    def told(self) -> str:
        """Sentence for the model's sources."""
        x, y, z = self.position_mm
        return (
            f"not known beyond slice {self.index} across axis {'ijk'[self.axis]} (middle at {x:.1f}, "
            f"{y:.1f}, {z:.1f} mm): the image ends within the organ"
        )


def open_ends(organ: BoolArray, grid: Grid) -> tuple[OpenEnd, ...]:
    """Find the borders of the grid at which the organ's mask, (nx, ny, nz), has voxels."""
    ends = []
    for axis, count in enumerate(grid.shape):
        layers = np.moveaxis(organ, axis, 0)
        for index, sign in ((0, -1.0), (count - 1, 1.0)):
            at = np.argwhere(layers[index])
            if len(at):
                middle = np.insert(at.mean(axis=0), axis, index)
                ends.append(OpenEnd(axis, index, grid.to_mm(middle), sign * grid.direction[:, axis]))
    return tuple(ends)


def seen_part(
    grid: Grid, organ: BoolArray, slice_shift_mm: FloatArray | None, descent: BaseDescent | None
) -> SeenPart | None:
    """Return the part of an organ's surface that a stack of slices shows; None for an image without gaps.

    Beyond the basal and the apical slice nothing is known: labels end there, not the heart. An apex that the
    next slice no longer shows ends half a pitch to one pitch beyond, and closing it leaves 3 to 5 mm. Nor is
    the surface known between slices more than GAP_MM apart.

    Args:
        grid, organ: of the stack, (nx, ny, nz) at end-diastole.
        slice_shift_mm: (nz, 3) by which the slices show the heart displaced; None: not known.
        descent: by which the shown part moves along the normal; None for an image without gaps.
    """
    if descent is None:
        return None
    normal = towards_base(grid, organ)
    slices = np.flatnonzero(organ.any(axis=(0, 1)))
    middles = grid.to_mm(np.column_stack([np.zeros((len(slices), 2)), slices]))
    middles = middles if slice_shift_mm is None else middles - slice_shift_mm[slices]
    heights = middles @ normal
    order = np.argsort(heights)
    heights = heights[order]
    apart_mm = np.abs(np.diff(slices[order])) * grid.spacing_mm[2]
    cuts = np.flatnonzero(apart_mm > GAP_MM) + 1
    slabs = [(part[0] - HALF_SLICE_MM, part[-1] + HALF_SLICE_MM) for part in np.split(heights, cuts)]
    still, phases = np.array(slabs), range(len(descent.base_mm))
    bounds = np.stack([still + descent.shift_mm(still, phase) for phase in phases])
    ends = np.array([heights[0] - HALF_SLICE_MM, heights[-1] + HALF_SLICE_MM])
    return SeenPart(normal, bounds, ends, descent.sigma_by_phase_mm)
