"""Points that carry their frame, landmarks that also carry names, and seed points of a segmentation."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dvf_ig.core.arrays import FloatArray, frozen_floats, read_only_arrays
from dvf_ig.core.errors import InvalidInputError

from .frames import check_frame, require_same_frame


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Positions (n, 3) in mm in one frame."""

    frame: str
    xyz_mm: FloatArray

    def __post_init__(self) -> None:
        check_frame(self.frame)
        object.__setattr__(self, "xyz_mm", frozen_floats(self.xyz_mm, f"points in '{self.frame}'", (None, 3)))

    def __len__(self) -> int:
        return int(self.xyz_mm.shape[0])


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Named points in one frame; names are unique."""

    names: tuple[str, ...]
    points: Points

    def __post_init__(self) -> None:
        if len(self.names) != len(self.points):
            raise InvalidInputError(f"{len(self.names)} landmark names for {len(self.points)} points")
        if len(set(self.names)) != len(self.names):
            raise InvalidInputError(f"landmark names repeat: {sorted(self.names)}; each name must be unique")

    @property
    def frame(self) -> str:
        return self.points.frame

    def paired_with(self, other: "Landmarks") -> tuple[tuple[str, ...], Points, Points]:
        """Match names common to both, in this one's order, with both point sets."""
        theirs = {name: i for i, name in enumerate(other.names)}
        common = tuple(name for name in self.names if name in theirs)
        mine = [self.names.index(name) for name in common]
        return (
            common,
            Points(self.frame, self.points.xyz_mm[mine]),
            Points(other.frame, other.points.xyz_mm[[theirs[name] for name in common]]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Seeds:
    """Seed points set by the user in the image.

    Attributes:
        heart: in the muscle.
        background: outside the heart; together they should surround it.
        cavity: in the blood inside the heart; may be empty if blood looks like muscle.
    """

    heart: Points
    background: Points
    cavity: Points

    def __post_init__(self) -> None:
        for name, points in (("heart", self.heart), ("background", self.background)):
            if len(points) == 0:
                raise InvalidInputError(f"no seed is named {name}; set at least one point of that name")
        require_same_frame(self.heart.frame, self.background.frame, "background seeds")
        require_same_frame(self.heart.frame, self.cavity.frame, "cavity seeds")


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TouchedPoints:
    """Points touched on the surface of the heart.

    Attributes:
        points: (n, 3) positions of the stylus tip, normally in "tracker".
        model_phase: (n,) place in the model's cycle at which each was touched; one number for all is their
            mean phase.
        sigma_mm: standard deviation of a point across the surface: stylus, phase, and difference of the
            patient from the model.
    """

    points: Points
    model_phase: FloatArray
    sigma_mm: float = 1.0

    def __post_init__(self) -> None:
        phase: Any = np.asarray(self.model_phase, dtype=np.float64)
        if phase.ndim == 0:
            phase = np.full(len(self.points), float(phase))
        object.__setattr__(
            self, "model_phase", frozen_floats(phase, "phases of touched points", (len(self.points),))
        )
        if not 0.05 <= self.sigma_mm <= 10.0:
            raise InvalidInputError(
                f"the standard deviation of touched points is {self.sigma_mm:g} mm; needed 0.05 to 10 mm"
            )

    def __len__(self) -> int:
        return len(self.points)
