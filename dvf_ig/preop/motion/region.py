"""Region of a 4-D image that is compared with end-diastole: the organ with a rim, in its own box."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from dvf_ig.core import AnyArray, BoolArray, FloatArray, Grid, VolumeSeries

from .consistency import parts_of
from .slice_stack import axis_of_lost_spacing, observable_axes

PADDING_MM = 8.0
"""Width of image kept beyond the voxels compared, for tissue that moves in from outside."""

THIN_WALL_MM = 5.0
"""Width of the rim along blood without a labelled wall: with the full rim, a thin right ventricle is matched
with the fat outside it (ACDC 002, Dice 0.57 against 0.82)."""


class Compared(NamedTuple):
    """Data in which all phases are compared with end-diastole, on the grid around the organ.

    Attributes:
        grey: (n, nx, ny, nz) grey levels; entry `ed_phase` is end-diastole.
        mask: (nx, ny, nz) voxels that are compared.
        parts: parts of the organ in which the way back is judged (`parts_of`).
        observable: (3,) axes along which motion is estimated.
    """

    grey: AnyArray
    ed_phase: int
    mask: BoolArray
    parts: tuple[BoolArray, ...]
    observable: BoolArray


def compared_region(
    image: VolumeSeries, organ: BoolArray, blood: BoolArray | None, ed_phase: int, rim_mm: float
) -> tuple[tuple[slice, slice, slice], Compared, bool]:
    """Cut out the box around the organ, what is compared in it, and whether the slices' spacing is lost."""
    box, mask = _region(organ, image.grid, rim_mm)
    spacing_mm = image.grid.spacing_mm
    if blood is not None:
        mask &= ~_beyond_thin_wall(organ[box], blood[box], spacing_mm)
    grey = image.values[(slice(None), *box)]
    lost = axis_of_lost_spacing(grey[ed_phase], spacing_mm)
    observable = observable_axes(spacing_mm) & (np.arange(3) != (-1 if lost is None else lost))
    parts = parts_of(organ[box], None if blood is None else blood[box])
    return box, Compared(grey, ed_phase, mask, parts, observable), lost is not None


def cropped_grid(grid: Grid, box: tuple[slice, slice, slice]) -> Grid:
    """Crop a grid to a box of its voxels."""
    start = np.array([part.start for part in box], dtype=np.float64)
    shape = (box[0].stop - box[0].start, box[1].stop - box[1].start, box[2].stop - box[2].start)
    return Grid(grid.frame, shape, grid.to_mm(start), grid.spacing_mm, grid.direction)


def _region(organ: BoolArray, grid: Grid, rim_mm: float) -> tuple[tuple[slice, slice, slice], BoolArray]:
    """Find the box of the image that is used, and in it the mask of voxels within `rim_mm` of the organ."""
    margin = np.ceil((rim_mm + PADDING_MM) / grid.spacing_mm).astype(int)
    bounds = ndimage.find_objects(organ.view(np.int8))[0]
    x, y, z = (
        slice(max(part.start - int(r), 0), min(part.stop + int(r), n))
        for part, r, n in zip(bounds, margin, grid.shape, strict=True)
    )
    from_organ_mm = ndimage.distance_transform_edt(~organ[x, y, z], sampling=grid.spacing_mm)
    return (x, y, z), np.asarray(from_organ_mm <= rim_mm)


def _beyond_thin_wall(organ: BoolArray, blood: BoolArray, spacing_mm: FloatArray) -> BoolArray:
    """Flag voxels further than THIN_WALL_MM from the organ, the nearest of which is labelled as blood."""
    within = np.where(observable_axes(spacing_mm), spacing_mm, 10.0 * THIN_WALL_MM)
    from_mm, nearest = ndimage.distance_transform_edt(~organ, sampling=within, return_indices=True)
    return np.asarray((from_mm > THIN_WALL_MM) & blood[tuple(nearest)])
