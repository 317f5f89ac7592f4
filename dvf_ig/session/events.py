"""Events of a session: samples, frames, poses and an operator's actions, each stamped by its source.

Stamps of every kind are seconds on one clock, that of the tracker and of the ECG. A frame's stamp is the
time at which it was recorded, with its pose; what its image shows happened `lag_s` later on that clock
(negative: earlier), which the session accounts for.
"""

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, InvalidInputError, read_only_arrays
from dvf_ig.core.arrays import frozen_floats
from dvf_ig.core.plausible import ECG_VALUE, LENGTH_MM, TIME_S, require_plausible


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class EcgSamples:
    """Consecutive samples of the ECG.

    Attributes:
        start_s: time of the first.
        samples: (n, leads) in any unit; NaN for missing samples.
    """

    start_s: float
    samples: FloatArray

    def __post_init__(self) -> None:
        _require_time(self.start_s, "ECG samples")
        samples = frozen_floats(self.samples, "ECG samples", (None, None), finite=False)
        require_plausible(samples, ECG_VALUE, "an ECG sample")
        object.__setattr__(self, "samples", samples)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RespirationSample:
    """One sample of what follows the breath.

    Attributes:
        t_s: when it was taken.
        values: (columns,), finite: one of a channel, three (mm) of a marker.
    """

    t_s: float
    values: FloatArray

    def __post_init__(self) -> None:
        _require_time(self.t_s, "a sample of breathing")
        object.__setattr__(self, "values", frozen_floats(self.values, "a sample of breathing", (None,)))


@dataclass(frozen=True, slots=True)
class Trigger:
    """A pulse of a hardware trigger, which replaces the ECG; it fired at `t_s`."""

    t_s: float

    def __post_init__(self) -> None:
        _require_time(self.t_s, "a trigger")


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TrackedFrame:
    """One ultrasound frame with the pose recorded with it.

    Attributes:
        t_s: when it was recorded.
        image: (rows, columns) uint8; None if the frame has none, or the recorder marked it invalid.
        tracker_from_probe: (4, 4); None if the tracker did not report OK.
    """

    t_s: float
    image: NDArray[np.uint8] | None
    tracker_from_probe: FloatArray | None

    def __post_init__(self) -> None:
        _require_time(self.t_s, "a tracked frame")
        if self.image is not None and (self.image.ndim != 2 or self.image.dtype != np.uint8):
            raise InvalidInputError(
                f"the image of a tracked frame has shape {self.image.shape} and type {self.image.dtype}; "
                "needed (rows, columns) of uint8"
            )
        if self.tracker_from_probe is not None:
            object.__setattr__(self, "tracker_from_probe", _pose(self.tracker_from_probe, "probe"))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ToolPose:
    """One pose of the tool.

    Attributes:
        t_s: when it was tracked.
        tracker_from_tool: (4, 4); None if the tracker did not report OK.
        by_encoders: measured by a haptic device that is the tool: at rest it repeats bit by bit, and
            ultrasound does not show it.
    """

    t_s: float
    tracker_from_tool: FloatArray | None
    by_encoders: bool = False

    def __post_init__(self) -> None:
        _require_time(self.t_s, "a tool pose")
        if self.tracker_from_tool is not None:
            object.__setattr__(self, "tracker_from_tool", _pose(self.tracker_from_tool, "tool"))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Landmark:
    """One anatomical point, marked on the model and touched on the patient.

    Attributes:
        t_s: when it was touched.
        mr_mm, tracker_mm: (3,) in frames "mr" and "tracker".
    """

    t_s: float
    name: str
    mr_mm: FloatArray
    tracker_mm: FloatArray

    def __post_init__(self) -> None:
        _require_time(self.t_s, "a landmark")
        for field in ("mr_mm", "tracker_mm"):
            point = frozen_floats(getattr(self, field), f"landmark {field}", (3,))
            require_plausible(point, LENGTH_MM, f"landmark {field}")
            object.__setattr__(self, field, point)


@dataclass(frozen=True, slots=True)
class Rearm:
    """The operator asks for force again after the supervisor latched; see `RearmAnswer`."""

    t_s: float

    def __post_init__(self) -> None:
        _require_time(self.t_s, "a re-arm")


Event = EcgSamples | RespirationSample | Trigger | TrackedFrame | ToolPose | Landmark | Rearm


def _require_time(t_s: float, what: str) -> None:
    if not isfinite(t_s):
        raise InvalidInputError(f"{what} is stamped {t_s} s; needed a finite time")
    require_plausible(t_s, TIME_S, f"the stamp of {what}, s,")


def _pose(matrix: FloatArray, source: str) -> FloatArray:
    """Copy a pose; whether it is finite and rigid is for the session to judge."""
    pose = frozen_floats(matrix, f"tracker_from_{source}", (4, 4), finite=False)
    require_plausible(pose, LENGTH_MM, f"tracker_from_{source}, mm,")
    return pose
