"""Geometry of calibration phantoms, and recordings of them."""

from dataclasses import dataclass
from typing import Literal

from dvf_ig.core.arrays import FloatArray, frozen_floats, read_only_arrays
from dvf_ig.core.errors import InvalidInputError

from .stream import PoseStream


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Wire:
    """Straight wire between two points of the phantom, (3,) mm each."""

    name: str
    front_mm: FloatArray
    back_mm: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "front_mm", frozen_floats(self.front_mm, f"wire {self.name}", (3,)))
        object.__setattr__(self, "back_mm", frozen_floats(self.back_mm, f"wire {self.name}", (3,)))


@dataclass(frozen=True, slots=True, eq=False)
class NWirePhantom:
    """N patterns: per pattern two parallel outer wires and the diagonal in the middle, in PLUS's order."""

    patterns: tuple[tuple[Wire, Wire, Wire], ...]

    @property
    def wires(self) -> tuple[Wire, ...]:
        return tuple(wire for pattern in self.patterns for wire in pattern)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class NWireRecording:
    """Wire crossings seen in tracked images of an N-wire phantom.

    Attributes:
        phantom: wire geometry in frame "phantom".
        phantom_from_probe: (n frames) pose of the probe's sensor against the phantom.
        points_px: (n, wires, 2) column, row of each wire in `phantom.wires` order; NaN if a frame was
            not segmented.
    """

    phantom: NWirePhantom
    phantom_from_probe: PoseStream
    points_px: FloatArray

    def __post_init__(self) -> None:
        needed = (len(self.phantom_from_probe), len(self.phantom.wires), 2)
        points = frozen_floats(self.points_px, "wire points", needed, finite=False)
        if self.phantom_from_probe.target != "phantom":
            raise InvalidInputError(
                f"N-wire poses are {self.phantom_from_probe.name}; needed phantom_from_probe"
            )
        object.__setattr__(self, "points_px", points)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TargetRecording:
    """Crossing of two wires, or a flat wall, seen in tracked images.

    Attributes:
        phantom: kind of the target: crossing or wall.
        poses: (n frames) probe against any frame in which the target does not move.
        points_px: (n, 1, 2) column, row of the crossing, or (n, 2, 2) of two points of the wall's line; NaN
            if not found.
    """

    phantom: Literal["cross-wire", "wall"]
    poses: PoseStream
    points_px: FloatArray

    def __post_init__(self) -> None:
        needed = (len(self.poses), 1 if self.phantom == "cross-wire" else 2, 2)
        points = frozen_floats(self.points_px, f"{self.phantom} points", needed, finite=False)
        object.__setattr__(self, "points_px", points)


@dataclass(frozen=True, slots=True)
class WireSearch:
    """Settings of the search for a phantom's wires in ultrasound images; None if not specified.

    Attributes:
        spacing_mm: pixel size.
        clip: first column, first row, columns, rows in px of the part of the image to search.
        candidates: largest number of bright dots considered.
        collinear_mm: largest distance of a dot from the line of its N pattern.
    """

    spacing_mm: float | None = None
    clip: tuple[int, int, int, int] | None = None
    candidates: int | None = None
    collinear_mm: float | None = None
