"""Geometry of a tool: its thickness, its shaft, and the fulcrum through which it reaches the organ."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, read_only_arrays
from dvf_ig.core.arrays import frozen_floats
from dvf_ig.kernels.servo.layout import MOST_SAMPLES, TOOL
from dvf_ig.kernels.servo.shaft import PITCH_MM

THICKEST_MM = 30.0
LONGEST_SHAFT_MM = PITCH_MM * (MOST_SAMPLES - 1)
LONGEST_MM = 1000.0


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Fulcrum:
    """Trocar: a fixed point of the body wall through which an instrument slides and turns.

    Attributes:
        point_mm: (3,) frame "tracker".
        length_mm: from the hand to the tip.
    Raises:
        InvalidInputError: a length out of range.
    """

    point_mm: FloatArray
    length_mm: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_mm", frozen_floats(self.point_mm, "fulcrum", (3,)))
        if not 10.0 <= self.length_mm <= LONGEST_MM:
            raise InvalidInputError(
                f"the instrument is {self.length_mm:g} mm long from hand to tip; needed 10 to "
                f"{LONGEST_MM:g} mm"
            )

    def other_end_mm(self, end_mm: FloatArray) -> FloatArray:
        """Return the hand (3,) that holds a tip (3,), or the tip of a hand, both in the frame "tracker"."""
        through = self.point_mm - end_mm
        return np.asarray(end_mm + self.length_mm / float(np.linalg.norm(through)) * through)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Tool:
    """Tool on which fixtures act; by default a point.

    A forbidden region acts on the surface of the whole tool, where it reaches deepest. A chamber and guidance
    to a surface act on the surface at the tip, a path on the centre of the tip.

    Attributes:
        diameter_mm: of tip and shaft.
        shaft_mm: length above the tip that no forbidden region may be touched by; 0: the tip alone.
        axis: (3,) direction from the tip to the handle, frame "tool"; None: through the fulcrum.
        fulcrum: None: the tool is held freely.
    Raises:
        InvalidInputError: a number out of range, or a shaft without a direction.
    """

    diameter_mm: float = 0.0
    shaft_mm: float = 0.0
    axis: FloatArray | None = None
    fulcrum: Fulcrum | None = None

    def __post_init__(self) -> None:
        for name, value, most in (
            ("diameter", self.diameter_mm, THICKEST_MM),
            ("shaft", self.shaft_mm, LONGEST_SHAFT_MM),
        ):
            if not 0.0 <= value <= most:
                raise InvalidInputError(f"the tool's {name} is {value:g} mm; needed 0 to {most:g} mm")
        if self.axis is not None:
            axis = frozen_floats(self.axis, "axis of the tool", (3,))
            size = float(np.linalg.norm(axis))
            if not size > 0.0:
                raise InvalidInputError("the axis of the tool is zero; needed its direction to the handle")
            object.__setattr__(self, "axis", frozen_floats(axis / size, "axis of the tool", (3,)))
        if self.shaft_mm > 0.0 and self.axis is None and self.fulcrum is None:
            raise InvalidInputError(
                "the direction of the tool's shaft is not known; state its axis, or the fulcrum that it "
                "passes through"
            )

    @property
    def radius_mm(self) -> float:
        return 0.5 * self.diameter_mm

    def axis_in_tracker(self, tracker_from_tool: FloatArray) -> FloatArray | None:
        """Return the axis (3,) by a rotation (3, 3); None if none is needed."""
        if self.axis is None or self.shaft_mm == 0.0 or self.fulcrum is not None:
            return None
        return np.asarray(tracker_from_tool @ self.axis)

    def handle_direction(
        self, tip_mm: FloatArray, tips_mm: FloatArray, tracker_from_tool: FloatArray
    ) -> FloatArray:
        """Return (n, 3) unit vectors from the tip to the handle, or to the sensor if no axis is stated.

        Args:
            tip_mm: (3,) frame "tool".
            tips_mm: (n, 3) the tip, frame "tracker".
            tracker_from_tool: (n, 3, 3) rotations.
        """
        if self.fulcrum is not None:
            along = self.fulcrum.point_mm - tips_mm
        else:
            along = tracker_from_tool @ (-tip_mm if self.axis is None else self.axis)
        size = np.linalg.norm(along, axis=1, keepdims=True)
        return np.where(size > 1e-6, along / np.maximum(size, 1e-6), tracker_from_tool[:, :, 2])

    def require_device(self, name: str) -> None:
        """Refuse a free shaft on a device, whose servo reads a position and no direction.

        Raises:
            InvalidInputError: says so.
        """
        if self.shaft_mm > 0.0 and self.fulcrum is None:
            raise InvalidInputError(
                f"{name} does not state where its shaft points; state the fulcrum that it passes through, or "
                "leave out tool.shaft_mm"
            )

    def packed(self, *, in_hand: bool, inward: float) -> Any:
        """Return (1,) TOOL for the kernels.

        Args:
            in_hand: the position that is read is the hand's, not the tip's.
            inward: 1 where the primary fixture's distance grows with the tool's thickness, −1 in a chamber,
                0 of a path.
        """
        packed = np.zeros(1, TOOL)
        packed["radius_mm"] = inward * self.radius_mm
        if self.shaft_mm > 0.0:
            pitches = math.ceil(self.shaft_mm / PITCH_MM)
            packed["shaft_mm"], packed["samples"] = self.shaft_mm, pitches + 1
            packed["pitch_mm"] = self.shaft_mm / pitches
        if self.fulcrum is not None:
            packed["trocar"], packed["trocar_mm"] = 1, self.fulcrum.point_mm
            packed["length_mm"] = self.fulcrum.length_mm if in_hand else 0.0
        return packed


POINT = Tool()
"""A tip without thickness."""
