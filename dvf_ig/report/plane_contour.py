"""Draw level lines of a distance field or of grey levels over an image in millimetres."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dvf_ig.core.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CASING = "#202020"


def image_extent(size_mm: tuple[float, float]) -> tuple[float, float, float, float]:
    """Return the extent of an image of this width and height whose first row is at the top."""
    return 0.0, size_mm[0], size_mm[1], 0.0


def draw_contour(
    axis: Axes,
    values: FloatArray | None,
    size_mm: tuple[float, float],
    color: str,
    *,
    level: float = 0.0,
    width: float = 1.2,
    dashed: bool = False,
    casing: bool = False,
) -> None:
    """Draw the level line of the values, if there is one.

    Args:
        values: (rows, columns), NaN for unknown; None draws nothing.
        size_mm: width and height of the image.
        casing: add a dark line below, for pale lines on bright images.
    """
    if values is None or not ((values < level).any() and (values > level).any()):
        return
    if casing:
        draw_contour(axis, values, size_mm, CASING, level=level, width=width + 0.8)
    axis.contour(
        values,
        levels=[level],
        colors=[color],
        linewidths=width,
        linestyles="dashed" if dashed else "solid",
        origin="upper",
        extent=image_extent(size_mm),
    )
