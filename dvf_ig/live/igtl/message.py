"""OpenIGTLink messages as values: device, time stamp, content, and named fields.

Matrices are (4, 4), mm, and map points of the tracked object to the frame it is tracked in, axes as the
sender has them; the wire holds them as float32.
Source: OpenIGTLink protocol, versions 1 to 3 (openigtlink.org).
"""

from dataclasses import dataclass, field
from enum import IntEnum
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core.arrays import FloatArray, read_only_arrays


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
