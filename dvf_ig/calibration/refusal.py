"""Why a frame took no part in a calibration, and why an estimate must not be used: its failed gates."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, TypeVar

from dvf_ig.core import QualityGateError


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


class Gate(StrEnum):
    """Quality gates of an estimate; the value describes the failure."""

    SMALL_ROTATION = "rotations too small"
    ONE_AXIS = "rotations about one axis only"
    FEW_AGREE = "too few samples agree"
    RESIDUAL = "residual too large"
    UNCERTAIN = "parameters left uncertain by the motion"
    FEW_MOVEMENTS = "too few movements"
    CORRELATION = "motions that do not match"
    SECOND_ANSWER = "another answer fits as well"
    END_OF_SEARCH = "best at the end of the search"


@dataclass(frozen=True, slots=True)
class Refusal:
    """The gate that failed, and in one sentence what was seen, what was needed and what to do."""

    gate: Gate
    detail: str


class Judged(Protocol):
    """Result with its refusals; it may be used if there are none."""

    @property
    def refusals(self) -> tuple[Refusal, ...]: ...


R = TypeVar("R", bound=Judged)


def accepted(result: R) -> R:
    """Return the result, or raise if a gate refused it.

    Raises:
        QualityGateError: a gate refused it; the message holds the sentence of each gate that did.
    """
    if result.refusals:
        raise QualityGateError("; ".join(refusal.detail for refusal in result.refusals))
    return result
