"""OpenIGTLink message header of 58 bytes, and the size limits of the body."""

import math
import struct
from dataclasses import dataclass

import numpy as np

from dvf_ig.io import limits
from dvf_ig.kernels.crc64 import TABLES, crc64_of

from .problem import WireError, WireProblem

_LAYOUT = struct.Struct(">H12s20sQQQ")
HEADER_BYTES = _LAYOUT.size
VERSIONS = (1, 2, 3)
KIND_BYTES, DEVICE_BYTES = 12, 20
_FRACTION = 2.0**32

_LARGEST = {
    "TRANSFORM": 48,
    "POSITION": 28,
    "QTRANS": 28,
    "TDATA": 70 * limits.WIRE_TOOLS,
    "QTDATA": 50 * limits.WIRE_TOOLS,
    "STATUS": 30 + limits.WIRE_TEXT_BYTES,
    "STRING": 4 + limits.WIRE_TEXT_BYTES,
    "IMAGE": 72 + limits.WIRE_IMAGE_BYTES,
}
"""Largest content that is read, without extended header and meta data, bytes."""


@dataclass(frozen=True, slots=True)
class Header:
    """Header of a message.

    Attributes:
        version: version of the header; from 2 on the body has an extended header and meta data.
        kind: type of the message, for example "TRANSFORM".
        stamp_s: None if the sender gave no time.
        body_bytes, crc: size and CRC of the body.
    """

    version: int
    kind: str
    device: str
    stamp_s: float | None
    body_bytes: int
    crc: int

    @property
    def is_read(self) -> bool:
        """Whether the body is read; bodies of other types are skipped."""
        return self.kind in _LARGEST


def decode_header(data: bytes | bytearray | memoryview) -> Header:
    """Decode a header; no memory is reserved for its body before this returns.

    Args:
        data: HEADER_BYTES.
    Raises:
        WireError: not a header, or a body larger than its type can have.
    """
    version, kind_bytes, device_bytes, stamp, body_bytes, crc = _LAYOUT.unpack(data)
    if version not in VERSIONS:
        raise WireError(WireProblem.VERSION)
    kind, device = _name(kind_bytes), _name(device_bytes)
    if not kind:
        raise WireError(WireProblem.NAME)
    stamp_s = None if stamp == 0 else stamp / _FRACTION
    largest = _LARGEST.get(kind, limits.WIRE_IMAGE_BYTES)
    if version > 1:
        largest += limits.WIRE_FIELDS_BYTES
    if body_bytes > largest:
        raise WireError(WireProblem.TOO_LARGE, kind, device, stamp_s)
    return Header(version, kind, device, stamp_s, body_bytes, crc)


def encode_header(kind: str, device: str, stamp_s: float | None, body: bytes, version: int) -> bytes:
    """Encode the header of a body.

    Raises:
        WireError: a name that is too long or not ASCII, or a time that is negative or not finite.
    """
    names = []
    for name, size in ((kind, KIND_BYTES), (device, DEVICE_BYTES)):
        if len(name) > size or not name.isascii() or (name and not name.isprintable()):
            raise WireError(WireProblem.NAME, kind, device)
        names.append(name.encode("ascii"))
    seconds = 0.0 if stamp_s is None else stamp_s
    if not (math.isfinite(seconds) and 0.0 <= seconds < _FRACTION):
        raise WireError(WireProblem.VALUE, kind, device)
    stamp = min(round(seconds * _FRACTION), (1 << 64) - 1)
    return _LAYOUT.pack(version, *names, stamp, len(body), checksum(body))


def checksum(body: bytes) -> int:
    """Compute the CRC-64 of a body."""
    return int(crc64_of(np.frombuffer(body, dtype=np.uint8), TABLES)) if body else 0


def _name(raw: bytes) -> str:
    """Decode a name up to the first NUL.

    Raises:
        WireError: not printable ASCII.
    """
    text = raw.partition(b"\0")[0]
    if not text.isascii() or (text and not text.decode("ascii").isprintable()):
        raise WireError(WireProblem.NAME)
    return text.decode("ascii")
