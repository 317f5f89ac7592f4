"""Scan conversion: the geometry of scan lines and their samples, and the image made from them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_synth.kernels import scan
from dvf_ig.core import FloatArray, InvalidInputError, read_only_arrays


@dataclass(frozen=True, slots=True)
class PolarGrid:
    """Scan lines that fan out from one (possibly virtual) apex.

    Attributes:
        lines, samples: scan lines, and samples along each; sample i covers the i-th of equal depth intervals
            and is at its middle.
        start_mm, stop_mm: distances of the lines' start and end from the apex.
        half_angle_rad: angle of the last line from the depth axis; the first is at minus this angle.
    """

    lines: int
    samples: int
    start_mm: float
    stop_mm: float
    half_angle_rad: float

    def __post_init__(self) -> None:
        if self.lines < 2 or self.samples < 2:
            raise InvalidInputError(
                f"the scan has {self.lines} lines of {self.samples} samples; needed 2 each"
            )
        if not 0 <= self.start_mm < self.stop_mm:
            raise InvalidInputError(
                f"scan lines run from {self.start_mm:g} to {self.stop_mm:g} mm; needed 0 <= start < stop"
            )
        if not 0.05 < self.half_angle_rad < 1.5:
            raise InvalidInputError(f"half angle is {self.half_angle_rad:g} rad; needed 0.05 to 1.5")

    @property
    def step_mm(self) -> float:
        """Depth between samples."""
        return (self.stop_mm - self.start_mm) / self.samples

    @property
    def angles_rad(self) -> FloatArray:
        """Angle (lines,) of each line from the depth axis, towards growing columns."""
        return np.linspace(-self.half_angle_rad, self.half_angle_rad, self.lines)


@dataclass(frozen=True, slots=True)
class PixelGrid:
    """Image raster, with (column, row) size of its pixels and the apex, which may be outside it."""

    rows: int
    columns: int
    mm_per_px: tuple[float, float]
    apex_px: tuple[float, float]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ScanConverter:
    """Lookup from pixels to lines and samples, made once for a geometry.

    Attributes:
        line, sample: (rows, columns) float32 fractional indices; line is −1 outside the insonified sector.
    """

    line: NDArray[np.float32]
    sample: NDArray[np.float32]

    @classmethod
    def of(cls, polar: PolarGrid, pixels: PixelGrid) -> "ScanConverter":
        row, column = np.mgrid[: pixels.rows, : pixels.columns]
        x = (column - pixels.apex_px[0]) * pixels.mm_per_px[0]
        y = (row - pixels.apex_px[1]) * pixels.mm_per_px[1]
        radius, angle = np.hypot(x, y), np.arctan2(x, y)
        inside = (radius >= polar.start_mm) & (radius <= polar.stop_mm)
        inside &= np.abs(angle) <= polar.half_angle_rad
        line = (angle + polar.half_angle_rad) / (2 * polar.half_angle_rad) * (polar.lines - 1)
        sample = np.clip((radius - polar.start_mm) / polar.step_mm - 0.5, 0, polar.samples - 1)
        return cls(np.where(inside, line, -1.0).astype(np.float32), sample.astype(np.float32))

    def __call__(self, grey: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Convert (lines, samples) grey levels 0…255 to a (rows, columns) image; 0 outside the sector."""
        image = np.empty(self.line.shape, dtype=np.uint8)
        scan.scan_convert(grey, self.line, self.sample, image)
        return image
