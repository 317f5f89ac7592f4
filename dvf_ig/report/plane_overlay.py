"""An ultrasound plane with the registered anatomy, as plain values for every page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core.arrays import FloatArray, read_only_arrays

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


def plane_section(corners: FloatArray, axis: int, level: float) -> FloatArray:
    """Intersect triangles with the plane on which coordinate `axis` is `level`, as (s, 2, 3) segments.

    Args:
        corners: (t, 3, 3) corners of the triangles; none may lie in the plane.
        axis: 0, 1 or 2.
        level: position of the plane along it.
    """
    height = corners[..., axis] - level
    cut = np.flatnonzero((height.min(axis=1) < 0.0) & (height.max(axis=1) > 0.0))
    corners, height = corners[cut], height[cut]
    ends, crossing = np.empty((len(cut), 3, 3)), np.empty((len(cut), 3), dtype=np.bool_)
    for k in range(3):
        a, b = height[:, k], height[:, (k + 1) % 3]
        crossing[:, k] = (a < 0.0) != (b < 0.0)
        share = a / np.where(a == b, 1.0, a - b)
        ends[:, k] = corners[:, k] + share[:, None] * (corners[:, (k + 1) % 3] - corners[:, k])
    return np.asarray(ends[crossing].reshape(-1, 2, 3))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class AnatomyPlane:
    """Pre-operative anatomy at the pixels of an ultrasound image, mapped by one pose.

    Attributes:
        grey: (rows, columns) grey level, 0 to 1; NaN outside the pre-operative image.
        distance_mm: (rows, columns) signed distance to the fixture model's surface, positive inside, NaN
            outside its box and where no slice of a stack shows it; None without a model.
        blood_mm: (rows, columns) likewise to the blood's border, which ultrasound shows; None if unknown.
        edges: the side of the patient towards which the left, right, upper and lower edge lie, as letters
            (R, L, A, P, S, I).
    """

    grey: FloatArray
    distance_mm: FloatArray | None
    blood_mm: FloatArray | None
    edges: tuple[str, str, str, str]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PlaneOverlay:
    """An ultrasound image, and the anatomy in its plane before and after registration.

    Attributes:
        name: of the image, for example "frame 37".
        plane: orientation of the plane by the registered pose, for example "axial, tilted by 12°".
        event_s: time of the image; None if unknown.
        model_phase: phase in the model's cycle, 0 to 1; None for an organ that does not beat.
        image: (rows, columns) grey levels, 0 to 255.
        pixel_mm: width and height of a pixel.
        start, registered: the anatomy mapped by the start pose and by the registered one.
        outline_levels: grey levels of the anatomy whose contours replace those of a model.
        anatomy_from_pixel: (3, 3) maps (column, row, 1) to mm in the anatomy's frame by the registered pose;
            None if not given.
        labels: (rows, columns) labels of the model's tissue by the registered pose; None without any.
        label_names: value and name of each.
    """

    name: str
    plane: str
    event_s: float | None
    model_phase: float | None
    image: NDArray[np.uint8]
    pixel_mm: tuple[float, float]
    start: AnatomyPlane
    registered: AnatomyPlane
    outline_levels: tuple[float, ...] = ()
    anatomy_from_pixel: FloatArray | None = None
    labels: NDArray[np.uint8] | None = None
    label_names: tuple[tuple[int, str], ...] = ()

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the image."""
        rows, columns = self.image.shape
        return columns * self.pixel_mm[0], rows * self.pixel_mm[1]

    @property
    def moment(self) -> str:
        """Text of the time and phase, if known."""
        parts = []
        if self.event_s is not None:
            parts.append(f"{self.event_s:.1f} s")
        if self.model_phase is not None:
            parts.append(f"{round(100 * self.model_phase) % 100} % of the cycle")
        return ", ".join(parts)
