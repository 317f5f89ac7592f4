"""Echo of a metal tool in a scan: a bright echo at the shaft, with ringing and a shadow behind it.

Applied to compressed images, whose grey is a linear scale of decibels: the echo adds as power, and the shadow
subtracts. If the shaft crosses the image, a short piece is shown, as long as the beam is thick; a shaft
within the image is a line that ends at the tip.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, map_coordinates

from dvf_ig.core import BoolArray, FloatArray, InvalidInputError

from .image_faults import with_echoes
from .probe import FWHM_PER_SIGMA, SectorProbe

_SHAFT_STEP_MM = 0.25
_GLINT_STEPS = 4.0
_LEAST_SHARE = 1e-3
"""Share of the echo of a shaft in the middle of the beam below which nothing is drawn."""


@dataclass(frozen=True, slots=True)
class ToolEchoSpec:
    """Straight metal tool.

    Attributes:
        shown: whether images show it at all.
        level_db: echo of a shaft across the beam, relative to myocardium's scatter.
        along_db: loss of a shaft along the beam, which reflects away from the probe.
        glint_db: standard deviation of the echo along the shaft, redrawn with every image.
        ringing_mm: depth over which the ringing falls to 1/e of its amplitude.
        shadow_db: two-way loss behind it.
        length_mm: length of the shaft from the tip on that may be visible.
    """

    shown: bool = False
    level_db: float = 20.0
    along_db: float = 18.0
    glint_db: float = 3.0
    ringing_mm: float = 1.2
    shadow_db: float = 15.0
    length_mm: float = 80.0

    def __post_init__(self) -> None:
        if min(self.along_db, self.glint_db, self.ringing_mm, self.shadow_db) < 0 or self.length_mm <= 0:
            raise InvalidInputError("a value of the tool's echo is negative; needed 0 or more")


def with_tool(
    images: NDArray[np.uint8],
    probe: SectorProbe,
    tip_mm: FloatArray,
    shaft: FloatArray,
    hidden: Callable[[int, FloatArray], BoolArray],
    spec: ToolEchoSpec,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Add the tool to those of (n, rows, columns) images that meet it.

    Args:
        tip_mm: (n, 3) tip at each image, frame "plane".
        shaft: (n, 3) unit vector from the tip up the shaft, frame "plane".
        hidden: (number of the image, (k, 3) points in frame "plane") to (k,) points that lung or bone hides.
    """
    line, sample = probe.pixel_lookup()
    seen = line >= 0
    at = np.stack([line[seen], sample[seen]])
    out = images.copy()
    for i, shown in enumerate(out):
        points, share = _in_view(probe, tip_mm[i], shaft[i], spec)
        clear = ~hidden(i, points)
        if not clear.any():
            continue
        echo, loss_db = _scan_lines(probe, points[clear], share[clear], shaft[i], spec, rng)
        loss, power = map_coordinates(loss_db, at, order=1), map_coordinates(echo, at, order=1) ** 2
        shown[seen] = with_echoes(shown[seen], probe, loss, power, probe.dynamic_range_db)
    return out


def _in_view(
    probe: SectorProbe, tip_mm: FloatArray, up: FloatArray, spec: ToolEchoSpec
) -> tuple[FloatArray, FloatArray]:
    """Find (k, 3) points of the shaft in the beams, and (k,) the share of their echo in the beam."""
    points = tip_mm + np.arange(0.0, spec.length_mm, _SHAFT_STEP_MM)[:, None] * up
    depth = np.hypot(points[:, 0], points[:, 1]) - probe.face_radius_mm
    sigma_mm = probe.elevation_fwhm_mm(np.maximum(depth, 1.0)) / FWHM_PER_SIGMA
    share = np.exp(-0.5 * (points[:, 2] / sigma_mm) ** 2)
    inside = (depth > 1.0) & (depth < probe.depth_mm) & (share > _LEAST_SHARE)
    inside &= np.abs(np.arctan2(points[:, 0], points[:, 1])) <= probe.half_angle_rad
    return points[inside], share[inside]


def _scan_lines(
    probe: SectorProbe,
    points: FloatArray,
    share: FloatArray,
    up: FloatArray,
    spec: ToolEchoSpec,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Compute the (lines, samples) amplitude of the echo, and loss in dB."""
    glint = gaussian_filter1d(rng.standard_normal(len(points)), _GLINT_STEPS)
    glint_db = spec.glint_db * glint * np.sqrt(2 * _GLINT_STEPS * np.sqrt(np.pi))
    depth = np.hypot(points[:, 0], points[:, 1]) - probe.face_radius_mm
    angle = np.arctan2(points[:, 0], points[:, 1])
    number = (angle + probe.half_angle_rad) / (2 * probe.half_angle_rad) * (probe.lines - 1)
    beam = points / np.linalg.norm(points, axis=1)[:, None]
    level_db = spec.level_db - spec.along_db * (beam @ up) ** 2 + glint_db
    cell = (np.rint(number).astype(int), (depth / probe.step_mm).astype(int))
    met, echo = np.zeros((2, probe.lines, probe.samples))
    np.maximum.at(met, cell, share)
    np.maximum.at(echo, cell, share * 10 ** (level_db / 20))
    return _shown(probe, echo, float(depth.mean()), spec), _loss_db(met, spec)


def _shown(probe: SectorProbe, echo: FloatArray, depth_mm: float, spec: ToolEchoSpec) -> FloatArray:
    """Spread amplitudes over the beam's width, with ringing in depth; peaks keep their height."""
    pitch_mm = depth_mm * 2 * probe.half_angle_rad / (probe.lines - 1)
    lateral = float(probe.lateral_fwhm_mm(depth_mm)) / FWHM_PER_SIGMA / pitch_mm
    axial = probe.axial_fwhm_mm / FWHM_PER_SIGMA / probe.step_mm
    wide = gaussian_filter1d(gaussian_filter1d(echo, lateral, axis=0), axial, axis=1)
    if wide.max() > 0:
        wide *= echo.max() / wide.max()
    decay = np.exp(-probe.step_mm / max(spec.ringing_mm, 1e-6))
    for k in range(1, wide.shape[1]):
        np.maximum(wide[:, k], decay * wide[:, k - 1], out=wide[:, k])
    return wide


def _loss_db(met: FloatArray, spec: ToolEchoSpec) -> FloatArray:
    """Compute the loss behind the shaft, blurred like the beams."""
    return np.asarray(gaussian_filter1d(spec.shadow_db * np.maximum.accumulate(met, axis=1), 1.0, axis=0))
