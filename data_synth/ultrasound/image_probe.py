"""Probe with a calibration measured on a real one: its image size, pixel size and mounting.

Such a file gives the positions of pixels, not how the scanner fills the image. Here a curved array fills
it: the widest sector of IMAGE_HALF_ANGLE_RAD whose face touches the upper edge and whose deepest line ends at
the lower one. In an image as deep as it is narrow it becomes a phased array.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dvf_ig.core import ImageMap, InvalidInputError, Rigid

from .probe import SectorProbe

IMAGE_HALF_ANGLE_RAD = float(np.deg2rad(20.0))
"""In 66 x 46 mm the face is 37 mm wide: a 38 mm linear array that steers its outer lines outwards."""
SHALLOW_MM = 100.0
"""Largest depth of an image from a high-frequency array."""
_STANDARD = SectorProbe()
_HIGH_FREQUENCY = SectorProbe(
    frequency_mhz=7.0,
    bandwidth_mhz=3.5,
    aperture_mm=12.0,
    focus_mm=25.0,
    depth_of_field_mm=20.0,
    elevation_aperture_mm=4.0,
    elevation_focus_mm=20.0,
    fine_lines=8,
)


@dataclass(frozen=True)
class CalibratedImage:
    """B-mode image of a probe from its calibration and its recordings.

    Attributes:
        probe_from_image: image calibration, frame "probe".
        columns, rows: size of the image.
    """

    probe_from_image: ImageMap
    columns: int
    rows: int

    def __post_init__(self) -> None:
        if not (64 <= self.columns <= 2048 and 64 <= self.rows <= 2048):
            raise InvalidInputError(
                f"the probe's image is {self.columns} x {self.rows} px; needed 64 to 2048 each way"
            )
        across_mm, down_mm = self._size_mm
        if not 20.0 <= min(across_mm, down_mm) <= max(across_mm, down_mm) <= 400.0:
            raise InvalidInputError(
                f"the probe's image is {across_mm:.4g} x {down_mm:.4g} mm; needed 20 to 400 mm each way: "
                "check that the size in pixels belongs to this calibration"
            )

    @property
    def _size_mm(self) -> tuple[float, float]:
        across, down = self.probe_from_image.scale_mm_per_px
        return float((self.columns - 1) * across), float((self.rows - 1) * down)

    @cached_property
    def probe(self) -> SectorProbe:
        """Build the scanner that makes this image."""
        across, down = (float(mm) for mm in self.probe_from_image.scale_mm_per_px)
        width_mm, height_mm = self._size_mm
        half = IMAGE_HALF_ANGLE_RAD
        stop_mm = 0.5 * width_mm / np.sin(half)
        face_radius_mm = max(0.0, (stop_mm - height_mm) / np.cos(half))
        stop_mm = min(stop_mm, height_mm + face_radius_mm * np.cos(half))
        depth_mm = stop_mm - face_radius_mm
        apex_row = -face_radius_mm * np.cos(half) / down
        return replace(
            _HIGH_FREQUENCY if depth_mm <= SHALLOW_MM else _STANDARD,
            depth_mm=float(depth_mm),
            half_angle_rad=half,
            rows=self.rows,
            columns=self.columns,
            mm_per_px=(across, down),
            apex_px=(0.5 * (self.columns - 1), float(apex_row)),
            face_radius_mm=float(face_radius_mm),
        )

    @property
    def probe_from_plane(self) -> Rigid:
        """Calibration from the fan apex, in mm."""
        return self.probe_from_image.rigid @ self.probe.plane_from_image.rigid.inverse()
