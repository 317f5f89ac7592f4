"""Why a frame of a calibration recording took no part in the calibration."""

from dataclasses import dataclass
from enum import StrEnum


class Rejection(StrEnum):
    """Kinds of reasons; the value is the message. Those of the search for wires are in its order."""

    IMAGE_INVALID = "image marked invalid"
    TOO_FEW_DOTS = "too few dots"
    NO_LINE = "no line of three dots"
    LINES_APART = "lines do not lie as in the phantom"
    MISFIT = "dots miss the phantom's shape"
    STEEP = "image too far from across the wires"
    NOT_FOUND = "phantom not found in the image"
    POSE_INVALID = "pose not valid"
    OUTLIER = "residual of an outlier"


@dataclass(frozen=True, slots=True)
class RejectedFrame:
    """The kind of reason, and in one sentence what was seen."""

    reason: Rejection
    detail: str
