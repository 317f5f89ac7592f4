"""Fan-shaped scan: its beam, its receiver, and the geometry of its lines and pixels."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import Fan, FloatArray, ImageMap, InvalidInputError, Rigid

from .scan_conversion import PixelGrid, PolarGrid, ScanConverter

SOUND_MM_PER_US = 1.54
FWHM_PER_SIGMA = 2.3548


@dataclass(frozen=True, slots=True)
class SectorProbe:
    """Geometry and physics of a phased or curvilinear sector scan.

    Plane frame "plane", mm: origin at the fan apex (the centre of a phased array's face, or the centre of a
    curved array's arc), x lateral (towards growing image columns and line numbers), y depth,
    z elevation = x × y. Depths count from the transducer's face.

    Attributes:
        lines, samples: scan lines, and receive samples along each.
        depth_mm: imaging depth.
        half_angle_rad: half opening angle.
        frequency_mhz, bandwidth_mhz: centre frequency, and −6 dB pulse-echo bandwidth.
        aperture_mm, focus_mm: active aperture and transmit focus.
        depth_of_field_mm: distance from the focus at which the beam is √2 times its focal angle.
        rows, columns: image raster.
        mm_per_px: (column, row) size of a pixel.
        apex_px: (column, row) of the fan apex.
        tgc_db_per_cm_mhz: one-way attenuation that time-gain compensation corrects.
        noise_db: receiver noise before compensation, relative to myocardium at the transducer.
        dynamic_range_db, top_db: log compression, and the level (relative to myocardium) shown as white.
        specular_db: echo of a facing interface, relative to its reflection coefficient.
        specular_power: exponent of the cosine with which interface echoes fall off when not facing the beam.
        fine_lines: lateral oversampling of the scatterers.
        face_radius_mm: radius of a curved array; 0 is a phased array.
        elevation_planes: planes summed over the beam's thickness; 1 is an infinitely thin slice.
        elevation_aperture_mm, elevation_focus_mm: height of the array and focus of its lens.
        bands: frequency compounding: this many disjoint sub-bands are detected and averaged.
        persistence: weight of the previous image in the current one, in a sequence.
        haze_db, haze_mm: level at the face (relative to myocardium) and decay length of near-field clutter.
        face_reflection: amplitude that the transducer's face reflects into the body: the reverberations
            behind lung and bone.
        dirty_shadow_db: clutter behind a total reflector, relative to the level that reaches it.
    """

    lines: int = 128
    samples: int = 512
    depth_mm: float = 150.0
    half_angle_rad: float = float(np.deg2rad(35.0))
    frequency_mhz: float = 3.0
    bandwidth_mhz: float = 1.5
    aperture_mm: float = 20.0
    focus_mm: float = 80.0
    depth_of_field_mm: float = 60.0
    rows: int = 320
    columns: int = 344
    mm_per_px: tuple[float, float] = (0.5, 0.5)
    apex_px: tuple[float, float] = (171.5, 6.0)
    tgc_db_per_cm_mhz: float = 0.33
    noise_db: float = -66.0
    dynamic_range_db: float = 60.0
    top_db: float = 21.0
    specular_db: float = 24.0
    specular_power: float = 3.0
    fine_lines: int = 4
    face_radius_mm: float = 0.0
    elevation_planes: int = 1
    elevation_aperture_mm: float = 12.0
    elevation_focus_mm: float = 70.0
    bands: int = 1
    persistence: float = 0.0
    haze_db: float = -math.inf
    haze_mm: float = 12.0
    face_reflection: float = 0.2
    dirty_shadow_db: float = -30.0

    def __post_init__(self) -> None:
        if self.lines < 8 or self.samples < 64 or self.samples % 8:
            raise InvalidInputError(
                f"probe has {self.lines} lines of {self.samples} samples; needed at least 8 lines "
                "and a multiple of 8 samples, at least 64"
            )
        if not 0.05 < self.half_angle_rad < 1.5:
            raise InvalidInputError(f"half angle is {self.half_angle_rad:g} rad; needed 0.05 to 1.5")
        if self.fine_lines < 2 or self.fine_lines % 2:
            raise InvalidInputError(f"fine_lines is {self.fine_lines}; needed a positive even number")
        if self.elevation_planes < 1 or self.bands < 1:
            raise InvalidInputError(
                f"probe has {self.elevation_planes} elevation planes and {self.bands} bands; needed 1 or more"
            )
        if not 0.0 <= self.persistence < 1.0:
            raise InvalidInputError(f"persistence is {self.persistence:g}; needed 0 to below 1")

    @property
    def step_mm(self) -> float:
        """Depth between receive samples; sample i lies at (i + ½) step."""
        return self.depth_mm / self.samples

    @property
    def depths_mm(self) -> FloatArray:
        """Depth (samples,) of each receive sample below the face."""
        return np.asarray((np.arange(self.samples) + 0.5) * self.step_mm)

    @property
    def polar(self) -> PolarGrid:
        """Scan lines about the fan apex."""
        stop_mm = self.face_radius_mm + self.depth_mm
        return PolarGrid(self.lines, self.samples, self.face_radius_mm, stop_mm, self.half_angle_rad)

    @property
    def line_angles_rad(self) -> FloatArray:
        """Angle (lines,) of each line from the depth axis, towards +x."""
        return self.polar.angles_rad

    @property
    def pixels(self) -> PixelGrid:
        """Image raster."""
        return PixelGrid(self.rows, self.columns, self.mm_per_px, self.apex_px)

    def pixel_lookup(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Fractional line and sample index (rows, columns) of each pixel; line −1 outside the sector."""
        converter = ScanConverter.of(self.polar, self.pixels)
        return converter.line, converter.sample

    @property
    def directions(self) -> FloatArray:
        """Unit vectors (lines, 3) of the scan lines, frame "plane"."""
        angles = self.line_angles_rad
        return np.column_stack([np.sin(angles), np.cos(angles), np.zeros(self.lines)])

    @property
    def wavelength_mm(self) -> float:
        return SOUND_MM_PER_US / self.frequency_mhz

    @property
    def axial_fwhm_mm(self) -> float:
        """Axial pulse width, 0.44 c/Δf of the whole band; sub-bands are `bands` times longer."""
        return 0.44 * SOUND_MM_PER_US / self.bandwidth_mhz * self.bands

    def lateral_fwhm_mm(self, depth_mm: FloatArray | float) -> FloatArray:
        """Compute the beam width 0.886 λ d/D · √(1 + ((d − focus)/depth of field)²)."""
        return self._beam_fwhm(depth_mm, self.aperture_mm, self.focus_mm)

    def elevation_fwhm_mm(self, depth_mm: FloatArray | float) -> FloatArray:
        """Compute the beam's thickness by the lateral law with the array's height and its lens."""
        return self._beam_fwhm(depth_mm, self.elevation_aperture_mm, self.elevation_focus_mm)

    def _beam_fwhm(self, depth_mm: FloatArray | float, aperture_mm: float, focus_mm: float) -> FloatArray:
        d = np.asarray(depth_mm, dtype=np.float64)
        focal = 0.886 * self.wavelength_mm * d / aperture_mm
        return np.asarray(focal * np.sqrt(1 + ((d - focus_mm) / self.depth_of_field_mm) ** 2))

    @property
    def fan(self) -> Fan:
        """Insonified sector in image pixels; for pixels that are not square, the largest inside it."""
        across, down = self.mm_per_px
        start_mm, stop_mm = self.polar.start_mm, self.polar.stop_mm
        if across == down:
            return Fan(np.array(self.apex_px), start_mm / down, stop_mm / down, self.half_angle_rad)
        # a circle in mm is an ellipse in pixels: its smallest and largest radius over the sector
        edge = np.array([np.sin(self.half_angle_rad) / across, np.cos(self.half_angle_rad) / down])
        per_mm = (1.0 / down, float(np.hypot(*edge)))
        half_angle = float(np.arctan2(*edge))
        return Fan(np.array(self.apex_px), start_mm * max(per_mm), stop_mm * min(per_mm), half_angle)

    @property
    def plane_from_image(self) -> ImageMap:
        """Map of pixel (column, row) to in-plane mm (x lateral, y depth, z = 0)."""
        scale = np.array(self.mm_per_px)
        origin = -np.append(scale * np.array(self.apex_px), 0.0)
        return ImageMap(Rigid("plane", "image", np.eye(3), origin), scale)
