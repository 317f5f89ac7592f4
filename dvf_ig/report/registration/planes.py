"""Fused ultrasound planes: ultrasound grey, pre-operative image in a second colour, the model's contours.

Left to right: fused at the start pose, fused at the registered one, the checkerboards of both.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from dvf_ig.core.arrays import BoolArray, FloatArray
from dvf_ig.report.plane_contour import draw_contour, image_extent
from dvf_ig.report.plane_overlay import AnatomyPlane, PlaneOverlay
from dvf_ig.report.style import MR_ON_GREY, ON_GREY

PANEL_IN = 3.9
"""Longer edge of a panel."""
SQUARES = 8
"""Of a checkerboard along the longer edge."""
TINT, STAIN = 0.55, 0.6
"""How much colour a bright pre-operative voxel adds to dark ultrasound, and takes from bright ultrasound."""
SCALE_BARS_MM = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
OVER_BRIGHT = [withStroke(linewidth=2.5, foreground="black")]
"""Under what is drawn in white."""
LETTER: dict[str, Any] = {"color": "white", "fontsize": 9, "path_effects": OVER_BRIGHT}


def fused_figure(overlay: PlaneOverlay, anatomy: AnatomyPlane) -> Figure:
    """Ultrasound in grey with the anatomy's grey levels in colour and the model's contours."""
    figure = _panel(fused_rgb(overlay.image, anatomy.grey), overlay, anatomy)
    axis = figure.axes[0]
    draw_contour(axis, anatomy.blood_mm, overlay.size_mm, "white", width=1.0, dashed=True, casing=True)
    draw_contour(axis, anatomy.distance_mm, overlay.size_mm, ON_GREY, width=1.7)
    for level in overlay.outline_levels:
        draw_contour(axis, anatomy.grey, overlay.size_mm, ON_GREY, level=level)
    return figure


def checkerboard_figure(overlay: PlaneOverlay, anatomy: AnatomyPlane) -> Figure:
    """Squares of the ultrasound in grey and of the anatomy in colour, in turn."""
    squares = checkerboard(overlay.image.shape, overlay.pixel_mm, max(overlay.size_mm) / SQUARES)
    rgb = np.where(squares[..., None], _coloured(anatomy.grey), _grey(overlay.image))
    return _panel(rgb, overlay, anatomy)


def fused_rgb(image: NDArray[np.uint8], grey: FloatArray) -> FloatArray:
    """(rows, columns, 3) ultrasound in grey, coloured by the anatomy's grey levels."""
    ultrasound, level = _grey(image), np.nan_to_num(grey)[..., None]
    color = np.array(to_rgb(MR_ON_GREY))
    stained = ultrasound * (1.0 - STAIN * level * (1.0 - color))
    return np.asarray(np.clip(stained + TINT * (1.0 - ultrasound) * level * color, 0.0, 1.0))


def checkerboard(shape: tuple[int, ...], pixel_mm: tuple[float, float], edge_mm: float) -> BoolArray:
    """(rows, columns) True in every second square."""
    row, column = np.indices(shape)
    return np.asarray((row * pixel_mm[1] // edge_mm + column * pixel_mm[0] // edge_mm) % 2 == 1)


def scale_bar_mm(width_mm: float) -> float:
    """Length of the scale bar: the largest of the round ones within a third of the width."""
    return max((bar for bar in SCALE_BARS_MM if bar <= width_mm / 3), default=SCALE_BARS_MM[0])


def _grey(image: NDArray[np.uint8]) -> FloatArray:
    return np.repeat(np.asarray(image, dtype=np.float64)[..., None] / 255.0, 3, axis=2)


def _coloured(grey: FloatArray) -> FloatArray:
    return np.asarray(np.nan_to_num(grey)[..., None] * np.array(to_rgb(MR_ON_GREY)))


def _panel(rgb: FloatArray, overlay: PlaneOverlay, anatomy: AnatomyPlane) -> Figure:
    """The image to scale, with a scale bar and the sides of the patient at its edges."""
    width_mm, height_mm = overlay.size_mm
    inch_per_mm = PANEL_IN / max(width_mm, height_mm)
    figure = Figure(figsize=(width_mm * inch_per_mm, height_mm * inch_per_mm), facecolor="black")
    axis = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axis.imshow(rgb, extent=image_extent(overlay.size_mm), interpolation="antialiased", aspect="auto")
    axis.set_axis_off()
    bar_mm, margin = scale_bar_mm(width_mm), 0.03 * max(width_mm, height_mm)
    y = height_mm - margin
    for color, width in (("black", 4.5), ("white", 2.5)):
        axis.plot([margin, margin + bar_mm], [y, y], color=color, lw=width, solid_capstyle="butt")
    axis.text(margin + bar_mm / 2, y - 0.6 * margin, f"{bar_mm:g} mm", ha="center", va="bottom", **LETTER)
    left, right, top, bottom = anatomy.edges
    axis.text(0.4 * margin, height_mm / 2, left, ha="left", va="center", **LETTER)
    axis.text(width_mm - 0.4 * margin, height_mm / 2, right, ha="right", va="center", **LETTER)
    axis.text(width_mm / 2, 0.4 * margin, top, ha="center", va="top", **LETTER)
    axis.text(width_mm / 2, height_mm - 0.4 * margin, bottom, ha="center", va="bottom", **LETTER)
    axis.set(xlim=(0.0, width_mm), ylim=(height_mm, 0.0))
    return figure
