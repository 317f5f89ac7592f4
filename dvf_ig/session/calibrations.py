"""The calibrations that a session works with: probe image and latency, and the tool's tip."""

from dataclasses import dataclass

from dvf_ig.core import ImageMap, InvalidInputError, Points
from dvf_ig.core.space.frames import require_same_frame


def require_lag(lag_s: float) -> None:
    """Raise InvalidInputError where it is no latency of video, s."""
    if not abs(lag_s) <= 1.0:
        raise InvalidInputError(f"the latency is {lag_s:g} s; needed -1 to 1 s (is it in ms?)")


@dataclass(frozen=True, slots=True, eq=False)
class UltrasoundCalibration:
    """What places every pixel of the ultrasound, in space and in time.

    Attributes:
        probe_from_image: image calibration.
        lag_s: t_tracker(event) = t_video + lag_s.
    """

    probe_from_image: ImageMap
    lag_s: float

    def __post_init__(self) -> None:
        require_lag(self.lag_s)


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationsInUse(UltrasoundCalibration):
    """The same, and what places the tool's tip.

    Attributes:
        tip: tool tip, one point in frame "tool".
    """

    tip: Points

    def __post_init__(self) -> None:
        UltrasoundCalibration.__post_init__(self)
        require_same_frame("tool", self.tip.frame, "tool tip of a session")
        if len(self.tip) != 1:
            raise InvalidInputError(f"the tool tip has {len(self.tip)} points; needed one")
