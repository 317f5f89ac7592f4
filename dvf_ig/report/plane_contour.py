"""The zero level of a distance field over an image in millimetres."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dvf_ig.core.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def image_extent(size_mm: tuple[float, float]) -> tuple[float, float, float, float]:
    """Extent of an image of that width and height whose first row is at the top."""
    return 0.0, size_mm[0], size_mm[1], 0.0


def draw_zero_contour(
    axis: Axes,
    distance_mm: FloatArray | None,
    size_mm: tuple[float, float],
    color: str,
    *,
    width: float = 1.2,
    dashed: bool = False,
) -> None:
    """Draw where the distance is 0, if anywhere.

    Args:
        distance_mm: (rows, columns), NaN where not known; None draws nothing.
        size_mm: width and height of the image.
    """
    if distance_mm is None or not ((distance_mm < 0).any() and (distance_mm > 0).any()):
        return
    axis.contour(
        distance_mm,
        levels=[0.0],
        colors=[color],
        linewidths=width,
        linestyles="dashed" if dashed else "solid",
        origin="upper",
        extent=image_extent(size_mm),
    )
