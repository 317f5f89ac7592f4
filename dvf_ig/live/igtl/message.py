"""Messages of OpenIGTLink as values, and what can be wrong with their bytes."""

from dataclasses import dataclass, field
from enum import Enum, IntEnum
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core.arrays import FloatArray, read_only_arrays
from dvf_ig.core.errors import InvalidInputError

UTF8, ASCII = 106, 3
"""Encodings of texts: IANA MIB numbers."""


class WireProblem(Enum):
    """Reason for refusing a message; the value is the sentence that a user reads."""

    VERSION = "the header's version is none of 1, 2 and 3"
    NAME = "type or device name is no text"
    TOO_LARGE = "the body is larger than a message of this type can be"
    TOO_SLOW = "the rest of the message did not come in time"
    CLOSED = "the peer closed the connection within a message"
    CHECKSUM = "the checksum does not belong to the body"
    SIZE = "the body's size does not fit what it states to hold"
    VALUE = "a field holds a value that the protocol does not know"
    NOT_FINITE = "a number is not finite"
    NOT_RIGID = "a matrix is not a rigid motion, or its translation is beyond a kilometre"


class WireError(InvalidInputError):
    """Refused message.

    Attributes:
        problem: the reason.
        kind, device, stamp_s: type, device name and time stamp of the message if its header was read.
    """

    def __init__(
        self, problem: WireProblem, kind: str = "", device: str = "", stamp_s: float | None = None
    ) -> None:
        self.problem, self.kind, self.device, self.stamp_s = problem, kind, device, stamp_s
        what = f"{kind} '{device}'" if kind else "an OpenIGTLink message"
        super().__init__(f"{what} is refused: {problem.value}")


class StatusCode(IntEnum):
    """Codes of STATUS messages that are sent."""

    OK = 1
    NOT_READY = 13
    DISABLED = 15


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """Pose (4, 4) of TRANSFORM, POSITION or QTRANS messages."""

    matrix: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """Image of an IMAGE message.

    Attributes:
        pixels: (slices, rows, columns) or, with several components, (slices, rows, columns, components).
        matrix: (4, 4) from voxel index (column, row, slice) to mm; the spacing is the length of its columns.
        lps: its axes are LPS, else RAS.
    """

    pixels: NDArray[Any]
    matrix: FloatArray
    lps: bool = False


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TrackedTool:
    """Tool of a TDATA or QTDATA message."""

    name: str
    matrix: FloatArray


@dataclass(frozen=True, slots=True)
class TrackingData:
    """Several tools tracked at one time."""

    tools: tuple[TrackedTool, ...]


@dataclass(frozen=True, slots=True)
class Status:
    """Content of STATUS: the protocol's code, the sender's own code and name of an error, and a sentence."""

    code: int
    subcode: int = 0
    name: str = ""
    text: str = ""


@dataclass(frozen=True, slots=True)
class Text:
    """STRING."""

    text: str


@dataclass(frozen=True, slots=True)
class Ignored:
    """Content of a message that is not used, such as queries (GET_, STT_, STP_)."""

    kind: str


Content = Transform | Image | TrackingData | Status | Text | Ignored

NO_FIELDS: MappingProxyType[str, str] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Message:
    """OpenIGTLink message.

    Attributes:
        device: device name.
        stamp_s: time stamp; None if the sender gave none.
        fields: meta data of a version 2 header, by key.
    """

    device: str
    stamp_s: float | None
    content: Content
    fields: MappingProxyType[str, str] = field(default_factory=lambda: NO_FIELDS)


def rigid_matrix(rotation_translation: Any) -> FloatArray:
    """(4, 4) of (3, 4)."""
    matrix = np.eye(4)
    matrix[:3] = rotation_translation
    return matrix


def decode_text(raw: memoryview, encoding: int) -> str:
    """Decode a text by its MIB number.

    Raises:
        WireError: another encoding than ASCII and UTF-8, or invalid bytes.
    """
    if encoding not in (ASCII, UTF8):
        raise WireError(WireProblem.VALUE)
    try:
        return bytes(raw).decode("utf-8")
    except UnicodeDecodeError as exc:
        raise WireError(WireProblem.VALUE) from exc
