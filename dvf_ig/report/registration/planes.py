"""Draw fused ultrasound planes: ultrasound grey, pre-operative image in a second colour, model contours.

Left to right: fused at the start pose, fused at the registered pose, the checkerboards of both.
"""

from __future__ import annotations

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dvf_ig.core.arrays import BoolArray, FloatArray
from dvf_ig.report.plane_contour import draw_contour, image_extent
from dvf_ig.report.plane_marks import draw_plane_marks
from dvf_ig.report.plane_overlay import AnatomyPlane, PlaneOverlay
from dvf_ig.report.style import MR_ON_GREY, ON_GREY

PANEL_IN = 3.9
"""Longer edge of a panel, inches."""
SQUARES = 8
"""Squares of a checkerboard along the longer edge."""
TINT, STAIN = 0.55, 0.6
"""Colour that a bright pre-operative voxel adds to dark ultrasound, and removes from bright ultrasound."""


def fused_figure(overlay: PlaneOverlay, anatomy: AnatomyPlane, *, tinted: bool = True) -> Figure:
    """Draw ultrasound in grey with the model's contours; if `tinted`, with the anatomy in colour."""
    rgb = fused_rgb(overlay.image, anatomy.grey) if tinted else _grey(overlay.image)
    figure = _panel(rgb, overlay, anatomy)
    axis = figure.axes[0]
    draw_contour(axis, anatomy.blood_mm, overlay.size_mm, "white", width=1.0, dashed=True, casing=True)
    draw_contour(axis, anatomy.distance_mm, overlay.size_mm, ON_GREY, width=1.7)
    for level in overlay.outline_levels:
        draw_contour(axis, anatomy.grey, overlay.size_mm, ON_GREY, level=level)
    return figure


def checkerboard_figure(overlay: PlaneOverlay, anatomy: AnatomyPlane) -> Figure:
    """Draw alternating squares of ultrasound in grey and anatomy in colour."""
    squares = checkerboard(overlay.image.shape, overlay.pixel_mm, max(overlay.size_mm) / SQUARES)
    rgb = np.where(squares[..., None], _coloured(anatomy.grey), _grey(overlay.image))
    return _panel(rgb, overlay, anatomy)


def fused_rgb(image: NDArray[np.uint8], grey: FloatArray) -> FloatArray:
    """Colour (rows, columns, 3) grey ultrasound by the anatomy's grey levels."""
    ultrasound, level = _grey(image), np.nan_to_num(grey)[..., None]
    color = np.array(to_rgb(MR_ON_GREY))
    stained = ultrasound * (1.0 - STAIN * level * (1.0 - color))
    return np.asarray(np.clip(stained + TINT * (1.0 - ultrasound) * level * color, 0.0, 1.0))


def checkerboard(shape: tuple[int, ...], pixel_mm: tuple[float, float], edge_mm: float) -> BoolArray:
    """Return (rows, columns) True in every second square."""
    row, column = np.indices(shape)
    return np.asarray((row * pixel_mm[1] // edge_mm + column * pixel_mm[0] // edge_mm) % 2 == 1)


def _grey(image: NDArray[np.uint8]) -> FloatArray:
    return np.repeat(np.asarray(image, dtype=np.float64)[..., None] / 255.0, 3, axis=2)


def _coloured(grey: FloatArray) -> FloatArray:
    return np.asarray(np.nan_to_num(grey)[..., None] * np.array(to_rgb(MR_ON_GREY)))


def _panel(rgb: FloatArray, overlay: PlaneOverlay, anatomy: AnatomyPlane) -> Figure:
    """Draw the image to scale, with a scale bar and the sides of the patient at its edges."""
    width_mm, height_mm = overlay.size_mm
    inch_per_mm = PANEL_IN / max(width_mm, height_mm)
    figure = Figure(figsize=(width_mm * inch_per_mm, height_mm * inch_per_mm), facecolor="black")
    axis = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axis.imshow(rgb, extent=image_extent(overlay.size_mm), interpolation="antialiased", aspect="auto")
    axis.set_axis_off()
    draw_plane_marks(axis, overlay.size_mm, anatomy.edges)
    return figure
