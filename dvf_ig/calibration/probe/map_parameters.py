"""An image calibration as eight numbers about an estimate: rotation, position of one pixel, pixel sizes.

Axes are the image's own: lateral along columns, axial along rows, elevation out of the plane. Shifts are
those of a chosen pixel, so that a rotation does not move it: the numbers are as independent as the data
allow.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import FloatArray, ImageMap, Rigid, read_only_arrays

PARAMETERS = (
    "about_lateral_rad",
    "about_axial_rad",
    "about_elevation_rad",
    "lateral_mm",
    "axial_mm",
    "elevation_mm",
    "log_column_size",
    "log_row_size",
)
"""Names and units, in order; with one pixel size for both directions the last two are one."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class MapParameters:
    """Steps away from `estimate`.

    Attributes:
        estimate: probe_from_image.
        center_px: (2,) column, row whose position the shifts are of.
        isotropic: one pixel size for columns and rows.
    """

    estimate: ImageMap
    center_px: FloatArray
    isotropic: bool = False

    @property
    def count(self) -> int:
        return 7 if self.isotropic else 8

    @property
    def names(self) -> tuple[str, ...]:
        return (*PARAMETERS[:6], "log_pixel_size") if self.isotropic else PARAMETERS

    def stepped(self, step: FloatArray) -> ImageMap:
        """Return the map `step` (count,) away, in the units of PARAMETERS."""
        rigid, scale = self.estimate.rigid, self.estimate.scale_mm_per_px
        rotation = rigid.rotation @ Rotation.from_rotvec(step[:3]).as_matrix()
        size = scale * np.exp(step[6:])
        center = self.center_mm + rigid.rotation @ step[3:6]
        origin = center - rotation[:, :2] @ (self.center_px * size)
        return ImageMap(Rigid(rigid.target, rigid.source, rotation, origin), size)

    def step_to(self, other: ImageMap) -> FloatArray:
        """Compute the (8,) step from the estimate to `other`, whatever the pixel sizes."""
        rigid = self.estimate.rigid
        rotation = Rotation.from_matrix(rigid.rotation.T @ other.rigid.rotation).as_rotvec()
        moved = other.apply_pixels(self.center_px[None]).xyz_mm[0] - self.center_mm
        sizes = np.log(other.scale_mm_per_px / self.estimate.scale_mm_per_px)
        return np.concatenate([rotation, rigid.rotation.T @ moved, sizes])

    @property
    def center_mm(self) -> FloatArray:
        """Position (3,) of `center_px` at the sensor."""
        return np.asarray(self.estimate.apply_pixels(self.center_px[None]).xyz_mm[0])

    def jacobian(self, pixels: FloatArray) -> FloatArray:
        """Compute (..., 3, count) mm per unit step by which pixels (..., 2) move along the image's axes."""
        arm = (pixels - self.center_px) * self.estimate.scale_mm_per_px
        out = np.zeros((*arm.shape[:-1], 3, 8))
        out[..., 2, 0] = arm[..., 1]
        out[..., 2, 1] = -arm[..., 0]
        out[..., 0, 2] = -arm[..., 1]
        out[..., 1, 2] = arm[..., 0]
        out[..., [0, 1, 2], [3, 4, 5]] = 1.0
        out[..., [0, 1], [6, 7]] = arm
        if self.isotropic:
            return np.concatenate([out[..., :6], out[..., 6:].sum(axis=-1, keepdims=True)], axis=-1)
        return out


def with_square_pixels(image_map: ImageMap, center_px: FloatArray) -> ImageMap:
    """Replace both pixel sizes by their geometric mean; the position of `center_px` is kept."""
    size = np.full(2, np.sqrt(image_map.scale_mm_per_px.prod()))
    rigid = image_map.rigid
    center = image_map.apply_pixels(center_px[None]).xyz_mm[0]
    origin = center - rigid.rotation[:, :2] @ (center_px * size)
    return ImageMap(Rigid(rigid.target, rigid.source, rigid.rotation, origin), size)
