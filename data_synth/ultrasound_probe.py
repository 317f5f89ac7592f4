"""A phased-sector probe: its beam, its receiver, and where its lines and pixels lie."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import Fan, FloatArray, ImageMap, InvalidInputError, Rigid

SOUND_MM_PER_US = 1.54


LATTICE_MM = 0.15
"""Pitch of the scatterer lattice: a third of the default pulse's axial width."""


def lattice_correlation(distance_mm: FloatArray) -> FloatArray:
    """Chance that two points this far apart lie in the same lattice cell, averaged over directions."""
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(64)
    height = 1 - (np.arange(64) + 0.5) / 32
    ring = np.sqrt(1 - height**2)
    directions = np.abs(np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height]))
    share = 1 - np.asarray(distance_mm)[..., None, None] * directions / LATTICE_MM
    return np.asarray(np.maximum(share, 0.0).prod(axis=-1).mean(axis=-1))


@dataclass(frozen=True, slots=True)
class SectorProbe:
    """Geometry and physics of a phased sector scan.

    Plane frame "plane", mm: origin at the fan apex (the centre of the transducer face), x lateral (towards
    growing image columns and line numbers), y depth, z elevation = x × y. One elevation plane.

    Attributes:
        lines, samples: scan lines, and receive samples along each.
        depth_mm: imaging depth.
        half_angle_rad: half opening angle.
        frequency_mhz, bandwidth_mhz: centre frequency, and −6 dB pulse-echo bandwidth.
        aperture_mm, focus_mm: active aperture and transmit focus.
        depth_of_field_mm: distance from the focus at which the beam is √2 times its focal angle.
        rows, columns, mm_per_px: image raster, isotropic pixels.
        apex_px: (column, row) of the fan apex.
        tgc_db_per_cm_mhz: one-way attenuation that time-gain compensation makes up for.
        noise_db: receiver noise before compensation, re myocardium at the transducer.
        dynamic_range_db, top_db: log compression, and the level (re myocardium) shown as white.
        specular_db: echo of a facing interface, re its reflection coefficient.
        specular_power: exponent of the cosine with which interface echoes fall off when not facing the beam.
        fine_lines: lateral oversampling of the scatterers.
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
    mm_per_px: float = 0.5
    apex_px: tuple[float, float] = (171.5, 6.0)
    tgc_db_per_cm_mhz: float = 0.33
    noise_db: float = -66.0
    dynamic_range_db: float = 60.0
    top_db: float = 21.0
    specular_db: float = 24.0
    specular_power: float = 3.0
    fine_lines: int = 4

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

    @property
    def step_mm(self) -> float:
        """Depth between receive samples; sample i lies at (i + ½) step."""
        return self.depth_mm / self.samples

    @property
    def line_angles_rad(self) -> FloatArray:
        """(lines,) angle of each line from the depth axis, towards +x."""
        return np.linspace(-self.half_angle_rad, self.half_angle_rad, self.lines)

    @property
    def wavelength_mm(self) -> float:
        return SOUND_MM_PER_US / self.frequency_mhz

    @property
    def axial_fwhm_mm(self) -> float:
        """0.44 c/Δf."""
        return 0.44 * SOUND_MM_PER_US / self.bandwidth_mhz

    def lateral_fwhm_mm(self, depth_mm: FloatArray | float) -> FloatArray:
        """0.886 λ d/D · √(1 + ((d − focus)/depth of field)²): the off-focus law of this simulator."""
        d = np.asarray(depth_mm, dtype=np.float64)
        focal = 0.886 * self.wavelength_mm * d / self.aperture_mm
        return np.asarray(focal * np.sqrt(1 + ((d - self.focus_mm) / self.depth_of_field_mm) ** 2))

    @property
    def fan(self) -> Fan:
        """The insonified sector in image pixels."""
        return Fan(np.array(self.apex_px), 0.0, self.depth_mm / self.mm_per_px, self.half_angle_rad)

    @property
    def plane_from_image(self) -> ImageMap:
        """Pixel (column, row) to in-plane mm (x lateral, y depth, z = 0)."""
        origin = -self.mm_per_px * np.array([self.apex_px[0], self.apex_px[1], 0.0])
        return ImageMap(
            Rigid("plane", "image", np.eye(3), origin), np.array([self.mm_per_px, self.mm_per_px])
        )

    def pixel_lookup(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(rows, columns) fractional line and sample index of each pixel; line −1 outside the sector."""
        row, column = np.mgrid[: self.rows, : self.columns]
        x = (column - self.apex_px[0]) * self.mm_per_px
        y = (row - self.apex_px[1]) * self.mm_per_px
        radius, angle = np.hypot(x, y), np.arctan2(x, y)
        inside = (radius <= self.depth_mm) & (np.abs(angle) <= self.half_angle_rad)
        line = (angle + self.half_angle_rad) / (2 * self.half_angle_rad) * (self.lines - 1)
        sample = np.clip(radius / self.step_mm - 0.5, 0, self.samples - 1)
        return np.where(inside, line, -1.0).astype(np.float32), sample.astype(np.float32)

    def axial_taps(self) -> NDArray[np.float32]:
        """Even number of Gaussian weights on the half-step raster, of unit energy."""
        sigma = self.axial_fwhm_mm / 2.3548 / (0.5 * self.step_mm)
        reach = int(np.ceil(3 * sigma))
        weights = np.exp(-0.5 * ((np.arange(2 * reach) - reach + 0.5) / sigma) ** 2)
        return np.asarray(weights / np.sqrt((weights**2).sum()), dtype=np.float32)

    def lateral_taps(self) -> NDArray[np.float32]:
        """(k, samples) Gaussian weights over fine lines at each depth; k is even.

        Scaled so that scatterers of unit power give unit power at every depth, although neighbouring fine
        lines share lattice cells near the probe.
        """
        depth = np.asarray((np.arange(self.samples) + 0.5) * self.step_mm, dtype=np.float64)
        pitch = 2 * self.half_angle_rad / (self.lines - 1) / self.fine_lines
        sigma = self.lateral_fwhm_mm(depth) / depth / 2.3548 / pitch
        reach = int(np.ceil(3 * sigma.max()))
        offset = (np.arange(2 * reach) - reach + 0.5)[:, None]
        weights = np.exp(-0.5 * (offset / sigma) ** 2)
        power = (weights**2).sum(axis=0)
        for lag in range(1, 2 * reach):
            shared = lattice_correlation(lag * pitch * depth)
            power += 2 * shared * (weights[lag:] * weights[:-lag]).sum(axis=0)
        return np.asarray(weights / np.sqrt(power), dtype=np.float32)

    def receive_gain(self) -> NDArray[np.float32]:
        """(samples,) time-gain compensation as an amplitude factor."""
        depth_cm = (np.arange(self.samples) + 0.5) * self.step_mm / 10
        decibel = 2 * self.tgc_db_per_cm_mhz * self.frequency_mhz * depth_cm
        return np.asarray(10 ** (decibel / 20), dtype=np.float32)
