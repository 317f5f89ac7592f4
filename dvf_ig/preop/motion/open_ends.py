"""Borders at which an image ends within the organ, beyond which its surface is not known."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, Grid, read_only_arrays


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
