"""An ultrasound plane with the registered anatomy, as plain values for every page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core.arrays import FloatArray, read_only_arrays


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class AnatomyPlane:
    """Pre-operative anatomy at the pixels of an ultrasound image, mapped by one pose.

    Attributes:
        grey: (rows, columns) grey level, 0 to 1; NaN outside the pre-operative image.
        distance_mm: (rows, columns) signed distance to the fixture model's surface, positive inside, NaN
            outside its box; None without a model.
        blood_mm: (rows, columns) signed distance to the blood's border, which ultrasound shows; None if
            unknown.
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
