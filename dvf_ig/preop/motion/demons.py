"""Non-rigid registration by diffeomorphic demons, an independent check of the free-form motion.

SimpleITK is imported only when it runs.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from dvf_ig.core import AnyArray, BoolArray, FloatArray, Grid, IntArray, InvalidInputError, read_only_arrays

from .image_match import blurred
from .slice_stack import observable_axes

if TYPE_CHECKING:
    import SimpleITK


@dataclass(frozen=True, slots=True)
class DemonsOptions:
    """Settings of diffeomorphic demons.

    Attributes:
        blurs_mm: standard deviation of the Gaussian on both images, coarse to fine.
        steps: iterations at each blur.
        smooth_mm: standard deviation of the Gaussian on the displacement after each iteration.
    """

    blurs_mm: tuple[float, ...] = (3.0, 1.0)
    steps: int = 30
    smooth_mm: float = 2.0

    def __post_init__(self) -> None:
        if not self.blurs_mm or min(self.blurs_mm) < 0.0 or self.steps < 1 or not self.smooth_mm > 0.0:
            raise InvalidInputError(
                "demons need blurs of 0 mm or more, at least one step, and a positive smoothing"
            )


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class DisplacementField:
    """Deformation x ↦ x + u(x), u linear between voxels.

    Attributes:
        grid: voxels on which it is given.
        values_mm: (nx, ny, nz, 3) mm along the grid's axes.
    """

    grid: Grid
    values_mm: FloatArray

    @classmethod
    def identity(cls, grid: Grid) -> "DisplacementField":
        return cls(grid, np.zeros((*grid.shape, 3)))

    def on_voxels(self) -> FloatArray:
        """Return (nx, ny, nz, 3) displacement at the voxel centres, mm along the grid's axes."""
        return self.values_mm

    def move(self, xyz_mm: FloatArray) -> FloatArray:
        """Displace (n, 3) points; outside the image the displacement at its border is used."""
        at = self.grid.to_index(xyz_mm).T
        moved = [
            ndimage.map_coordinates(self.values_mm[..., a], at, order=1, mode="nearest") for a in range(3)
        ]
        return np.asarray(xyz_mm + np.stack(moved, axis=1) @ self.grid.direction.T)


def match_images_by_demons(
    fixed: AnyArray,
    moving: AnyArray,
    mask: BoolArray,
    start: DisplacementField,
    options: DemonsOptions = DemonsOptions(),
    *,
    observable: BoolArray | None = None,
) -> DisplacementField:
    """Find the displacement that makes moving(x + u(x)) similar to fixed(x).

    Args:
        fixed, moving: (nx, ny, nz) grey levels on the start's grid.
        mask: voxels whose mean and standard deviation normalise both images; demons compare all voxels.
        start: initial displacement.
        observable: (3,) axes along which motion is estimated; None decides by the voxel size.
    Source: Vercauteren 2009, as implemented in ITK; on one thread, so that its sums have one order.
    """
    import SimpleITK

    spacing = start.grid.spacing_mm
    if observable is None:
        observable = observable_axes(spacing)
    values = start.values_mm
    for blur_mm in options.blurs_mm:
        step = np.maximum(np.rint(blur_mm / spacing), 1).astype(int)
        thin = tuple(slice(None, None, int(s)) for s in step)
        pair = [_scaled(blurred(v, spacing, blur_mm), mask)[thin] for v in (fixed, moving)]
        demons = SimpleITK.DiffeomorphicDemonsRegistrationFilter()
        demons.SetNumberOfThreads(1)
        demons.SetNumberOfIterations(options.steps)
        demons.SetStandardDeviations((options.smooth_mm / (spacing * step)).tolist())
        images = [_sitk_image(grey, spacing * step) for grey in pair]
        field = demons.Execute(*images, _sitk_image(values[thin], spacing * step, vector=True))
        field_mm = np.swapaxes(SimpleITK.GetArrayFromImage(field), 0, 2)
        values = _upsampled(field_mm, step, start.grid.shape) * observable
    return DisplacementField(start.grid, values)


def _upsampled(values: FloatArray, step: IntArray, shape: tuple[int, int, int]) -> FloatArray:
    """Interpolate displacements on every step-th voxel to all voxels."""
    if (step == 1).all():
        return np.ascontiguousarray(values)
    at = np.indices(shape) / step.reshape(3, 1, 1, 1)
    fine = [ndimage.map_coordinates(values[..., a], at, order=1, mode="nearest") for a in range(3)]
    return np.stack(fine, axis=-1)


def _scaled(grey: FloatArray, mask: BoolArray) -> FloatArray:
    inside = grey[mask]
    if not inside.std() > 0.0:
        raise InvalidInputError(
            "an image has no contrast around the organ; check that it is the right 4-D image"
        )
    return np.asarray((grey - inside.mean()) / inside.std())


def _sitk_image(values: FloatArray, spacing_mm: FloatArray, *, vector: bool = False) -> "SimpleITK.Image":
    import SimpleITK

    image = SimpleITK.GetImageFromArray(np.ascontiguousarray(np.swapaxes(values, 0, 2)), isVector=vector)
    image.SetSpacing(spacing_mm.tolist())
    return image
