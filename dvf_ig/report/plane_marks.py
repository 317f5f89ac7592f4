"""Orientation of a plane in the patient: its name, the letters at its edges, and a scale bar.

Axes are LPS: +x to the patient's left (L), +y to the back (P), +z towards the head (superior, S).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.patheffects import withStroke

from dvf_ig.core.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SCALE_BARS_MM = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
OVER_BRIGHT = [withStroke(linewidth=2.5, foreground="black")]
"""Dark outline of white marks on bright images."""
LETTER: dict[str, Any] = {"color": "white", "fontsize": 9, "path_effects": OVER_BRIGHT}
PLANES = ("sagittal", "coronal", "axial")
"""The planes across x, y and z."""
LETTERS = ("RL", "AP", "IS")
"""The sides towards which −x and +x, −y and +y, −z and +z point."""
SHARED = 0.5
"""Component along an axis from which a direction is named after it."""
OBLIQUE_DEG, ALIGNED_DEG = 25.0, 3.0
LETTERS_NOTE = (
    "Letters at the edges: right (R) and left (L), front (A) and back (P), superior (S, towards the head) "
    "and inferior (I) of the patient"
)
"""Explanation of the letters for a page."""


def plane_name(normal: FloatArray) -> str:
    """Name the plane across `normal` (3,), with its tilt if any."""
    share = np.abs(normal) / np.linalg.norm(normal)
    nearest = int(share.argmax())
    tilt_deg = float(np.degrees(np.arccos(min(share[nearest], 1.0))))
    if tilt_deg >= OBLIQUE_DEG:
        return f"oblique, {tilt_deg:.0f}° from {PLANES[nearest]}"
    if tilt_deg >= ALIGNED_DEG:
        return f"{PLANES[nearest]}, tilted by {tilt_deg:.0f}°"
    return PLANES[nearest]


def edge_letters(right: FloatArray, down: FloatArray) -> tuple[str, str, str, str]:
    """Name the sides of the patient at the left, right, upper and lower edge of an image.

    Args:
        right, down: (3,) directions in which its columns and rows count.
    """
    return _letters(-right), _letters(right), _letters(-down), _letters(down)


def _letters(direction: FloatArray) -> str:
    """List letters of the axes along a direction, the largest component first."""
    unit = direction / np.linalg.norm(direction)
    order = np.argsort(-np.abs(unit), kind="stable")
    return "".join(LETTERS[a][int(unit[a] > 0)] for a in order if abs(unit[a]) >= SHARED)


def viewed_upright(axes: FloatArray) -> tuple[int, int, bool, bool]:
    """Orient a plane as radiologists do: left of the patient to the right, head up, front up.

    Args:
        axes: (2, 3) unit directions of the plane's two axes.
    Returns:
        which axis runs along the columns and which along the rows, and whether each is reversed.
    """
    across = int(np.abs(np.cross(axes[0], axes[1])).argmax())
    right, down = (
        np.eye(3)[0 if across != 0 else 1],
        np.array([0.0, 1.0, 0.0]) if across == 2 else np.array([0.0, 0.0, -1.0]),
    )
    straight = abs(axes[0] @ right) + abs(axes[1] @ down)
    swapped = abs(axes[1] @ right) + abs(axes[0] @ down)
    column, row = (0, 1) if straight >= swapped else (1, 0)
    return column, row, bool(axes[column] @ right < 0), bool(axes[row] @ down < 0)


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
