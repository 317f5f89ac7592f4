"""The map from ultrasound pixels to a tracked sensor: rigid times pixel scale."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dvf_ig.core.arrays import FloatArray, frozen_floats, read_only_arrays
from dvf_ig.core.errors import InvalidInputError

from .points import Points
from .rigid import Rigid, nearest_rotation

MAX_SHEAR_DEG = 1.0


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ImageMap:
    """probe_from_image = rigid · diag(sx, sy, 1): pixel (column, row) to mm at the probe's sensor.

    The frame "probe" is that of the sensor on the probe; PLUS calls the map ImageToProbe, JSON results
    `sensor_from_image`. A sensor of another name gives the map its name: `rigid.target`.

    Attributes:
        rigid: probe_from_image without its scale (source frame "image", in mm).
        scale_mm_per_px: (2,) column and row pixel size.
        shear_deg: deviation from orthogonal of columns 1–2 of an imported matrix, else 0.
    """

    rigid: Rigid
    scale_mm_per_px: FloatArray
    shear_deg: float = 0.0

    def __post_init__(self) -> None:
        scale = frozen_floats(self.scale_mm_per_px, "pixel scale", (2,))
        if (scale <= 0).any():
            raise InvalidInputError(f"pixel scale is {scale.tolist()} mm/px; both must be positive")
        if not abs(self.shear_deg) <= MAX_SHEAR_DEG:
            raise InvalidInputError(
                f"the image axes are {self.shear_deg:g}° off orthogonal; needed at most {MAX_SHEAR_DEG:g}°"
            )
        object.__setattr__(self, "scale_mm_per_px", scale)

    @property
    def matrix(self) -> FloatArray:
        """Return the (4, 4) probe_from_image in mm per pixel; its third column has unit norm."""
        out = self.rigid.matrix
        out[:3, 0] *= self.scale_mm_per_px[0]
        out[:3, 1] *= self.scale_mm_per_px[1]
        return out

    @classmethod
    def from_matrix(cls, matrix: Any, sensor: str, image: str = "image") -> "ImageMap":
        """Build from a PLUS ImageToProbe matrix: columns 1–2 are orthonormalised, the third is rebuilt.

        Raises:
            InvalidInputError: columns 1–2 further than 1° from orthogonal, or of zero length.
        """
        m = frozen_floats(matrix, f"matrix of {sensor}_from_{image}", (4, 4))
        columns = m[:3, :2]
        scale = np.linalg.norm(columns, axis=0)
        if (scale < 1e-9).any():
            raise InvalidInputError(f"{sensor}_from_{image}: an image axis has zero length")
        unit = columns / scale
        shear_deg = abs(90.0 - float(np.degrees(np.arccos(np.clip(unit[:, 0] @ unit[:, 1], -1, 1)))))
        if shear_deg > MAX_SHEAR_DEG:
            raise InvalidInputError(
                f"{sensor}_from_{image}: image axes are {shear_deg:.2f}° off orthogonal, needed at most "
                f"{MAX_SHEAR_DEG}°; calibrate the probe again"
            )
        third = np.cross(unit[:, 0], unit[:, 1])
        rotation = nearest_rotation(np.column_stack([unit, third / np.linalg.norm(third)]))
        return cls(Rigid(sensor, image, rotation, m[:3, 3]), scale, shear_deg)

    def apply_pixels(self, pixels: FloatArray) -> Points:
        """Map (n, 2) pixel positions (column, row) to mm in the probe's frame."""
        flat = np.column_stack([pixels * self.scale_mm_per_px, np.zeros(len(pixels))])
        return Points(self.rigid.target, self.rigid.apply_array(flat))
