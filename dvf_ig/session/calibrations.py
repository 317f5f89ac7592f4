"""The calibrations that a session works with: tool tip, probe image and latency."""

from dataclasses import dataclass

from dvf_ig.core import ImageMap, InvalidInputError, Points
from dvf_ig.core.frames import require_same_frame


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationsInUse:
    """What places the tool's tip and every pixel of the ultrasound, in space and in time.

    Attributes:
        tip: tool tip, one point in frame "tool".
        probe_from_image: image calibration.
        lag_s: t_tracker(event) = t_video + lag_s.
    """

    tip: Points
    probe_from_image: ImageMap
    lag_s: float

    def __post_init__(self) -> None:
        require_same_frame("tool", self.tip.frame, "tool tip of a session")
        if len(self.tip) != 1:
            raise InvalidInputError(f"the tool tip has {len(self.tip)} points; needed one")
        if not abs(self.lag_s) <= 1.0:
            raise InvalidInputError(f"the latency is {self.lag_s:g} s; needed -1 to 1 s (is it in ms?)")
