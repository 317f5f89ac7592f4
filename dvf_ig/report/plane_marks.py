"""Draw a scale bar and the sides of the patient at the edges of an image plane."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from matplotlib.patheffects import withStroke

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SCALE_BARS_MM = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
OVER_BRIGHT = [withStroke(linewidth=2.5, foreground="black")]
"""Dark outline of white marks on bright images."""
LETTER: dict[str, Any] = {"color": "white", "fontsize": 9, "path_effects": OVER_BRIGHT}


def scale_bar_mm(width_mm: float) -> float:
    """Choose the length of the scale bar: the largest round one within a third of the width."""
    return max((bar for bar in SCALE_BARS_MM if bar <= width_mm / 3), default=SCALE_BARS_MM[0])


def draw_plane_marks(axis: Axes, size_mm: tuple[float, float], edges: tuple[str, str, str, str]) -> None:
    """Draw the marks on an axis in mm, with rows that grow downwards.

    Args:
        size_mm: width and height of the plane.
        edges: the side of the patient at the left, right, upper and lower edge.
    """
    width_mm, height_mm = size_mm
    bar_mm, margin = scale_bar_mm(width_mm), 0.03 * max(width_mm, height_mm)
    y = height_mm - margin
    for color, width in (("black", 4.5), ("white", 2.5)):
        axis.plot([margin, margin + bar_mm], [y, y], color=color, lw=width, solid_capstyle="butt")
    axis.text(margin + bar_mm / 2, y - 0.6 * margin, f"{bar_mm:g} mm", ha="center", va="bottom", **LETTER)
    left, right, top, bottom = edges
    axis.text(0.4 * margin, height_mm / 2, left, ha="left", va="center", **LETTER)
    axis.text(width_mm - 0.4 * margin, height_mm / 2, right, ha="right", va="center", **LETTER)
    axis.text(width_mm / 2, 0.4 * margin, top, ha="center", va="top", **LETTER)
    axis.text(width_mm / 2, height_mm - 0.4 * margin, bottom, ha="center", va="bottom", **LETTER)
    axis.set(xlim=(0.0, width_mm), ylim=(height_mm, 0.0))
