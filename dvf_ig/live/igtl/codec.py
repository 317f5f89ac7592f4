"""Conversion between OpenIGTLink bytes, in any pieces, and messages: header, body, fields; no socket."""

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from dvf_ig.io import limits
from dvf_ig.kernels.crc64 import TABLES, crc64_of

from .contents import (
    decode_image,
    decode_position,
    decode_quaternion_tracking,
    decode_status,
    decode_string,
    decode_tracking,
    decode_transform,
    encode_image,
    encode_status,
    encode_string,
    encode_tracking,
    encode_transform,
)
from .message import (
    NO_FIELDS,
    UTF8,
    Content,
    Ignored,
    Image,
    Message,
    Status,
    Text,
    TrackingData,
    Transform,
    WireError,
    WireProblem,
    decode_text,
)

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


_EXTENDED = struct.Struct(">HHII")
_COUNT = struct.Struct(">H")
_ENTRY = struct.Struct(">HHI")


def split_body(body: memoryview) -> tuple[memoryview, MappingProxyType[str, str]]:
    """Split a version 2 body into its content and its fields.

    Raises:
        WireError: sizes that do not fit the body, or invalid texts.
    """
    if len(body) < _EXTENDED.size:
        raise WireError(WireProblem.SIZE)
    size, index_bytes, text_bytes, _ = _EXTENDED.unpack_from(body)
    end = len(body) - index_bytes - text_bytes
    if not _EXTENDED.size <= size <= end or index_bytes + text_bytes > limits.WIRE_FIELDS_BYTES:
        raise WireError(WireProblem.SIZE)
    content, index = body[size:end], body[end : end + index_bytes]
    return content, _fields(index, body[end + index_bytes :])


def joined_body(content: bytes, fields: Mapping[str, str]) -> bytes:
    """A version 2 body."""
    index, texts = [_COUNT.pack(len(fields))], []
    for key, value in fields.items():
        key_bytes, value_bytes = key.encode(), value.encode()
        index.append(_ENTRY.pack(len(key_bytes), UTF8, len(value_bytes)))
        texts += [key_bytes, value_bytes]
    index_bytes, text_bytes = b"".join(index), b"".join(texts)
    extended = _EXTENDED.pack(_EXTENDED.size, len(index_bytes), len(text_bytes), 0)
    return extended + content + index_bytes + text_bytes


def _fields(index: memoryview, texts: memoryview) -> MappingProxyType[str, str]:
    if not index and not texts:
        return NO_FIELDS
    if len(index) < _COUNT.size:
        raise WireError(WireProblem.SIZE)
    (count,) = _COUNT.unpack_from(index)
    if len(index) != _COUNT.size + count * _ENTRY.size:
        raise WireError(WireProblem.SIZE)
    fields, at = {}, 0
    for i in range(count):
        key_bytes, encoding, value_bytes = _ENTRY.unpack_from(index, _COUNT.size + i * _ENTRY.size)
        if at + key_bytes + value_bytes > len(texts):
            raise WireError(WireProblem.SIZE)
        key = decode_text(texts[at : at + key_bytes], UTF8)
        at += key_bytes
        fields[key] = decode_text(texts[at : at + value_bytes], encoding)
        at += value_bytes
    if at != len(texts):
        raise WireError(WireProblem.SIZE)
    return MappingProxyType(fields)


_DECODE: dict[str, Callable[[memoryview], Content]] = {
    "TRANSFORM": decode_transform,
    "POSITION": decode_position,
    "QTRANS": decode_position,
    "TDATA": decode_tracking,
    "QTDATA": decode_quaternion_tracking,
    "IMAGE": decode_image,
    "STATUS": decode_status,
    "STRING": decode_string,
}
_ENCODE: dict[type, tuple[str, Callable[[Any], bytes]]] = {
    Transform: ("TRANSFORM", encode_transform),
    TrackingData: ("TDATA", encode_tracking),
    Image: ("IMAGE", encode_image),
    Status: ("STATUS", encode_status),
    Text: ("STRING", encode_string),
}


def decode(header: bytes, body: bytes) -> Message:
    """Decode a message from the bytes of its header and of its body.

    Raises:
        WireError: bytes that the protocol or a limit does not allow.
    """
    return decode_body(decode_header(header), body)


def decode_body(header: Header, body: bytes) -> Message:
    """Decode the message of a body.

    Raises:
        WireError: with type, device and stamp of the header.
    """
    try:
        if len(body) != header.body_bytes:
            raise WireError(WireProblem.SIZE)
        if not header.is_read:
            return Message(header.device, header.stamp_s, Ignored(header.kind))
        if checksum(body) != header.crc:
            raise WireError(WireProblem.CHECKSUM)
        content, fields = memoryview(body), NO_FIELDS
        if header.version > 1:
            content, fields = split_body(content)
        return Message(header.device, header.stamp_s, _DECODE[header.kind](content), fields)
    except WireError as error:
        raise WireError(error.problem, header.kind, header.device, header.stamp_s) from error


def encode(message: Message) -> bytes:
    """Encode a message: version 2 if it has fields, else version 1, which all programs read.

    Raises:
        WireError: a value that the protocol cannot hold; TypeError for `Ignored`, which is not sent.
    """
    if type(message.content) not in _ENCODE:
        raise WireError(WireProblem.VALUE, type(message.content).__name__, message.device)
    kind, encode_content = _ENCODE[type(message.content)]
    body, version = encode_content(message.content), 1
    if message.fields:
        body, version = joined_body(body, message.fields), 2
    return encode_header(kind, message.device, message.stamp_s, body, version) + body


Taken = Message | WireError


class Incoming:
    """Incremental decoder of a byte stream; it never holds more than one message and one piece."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._header: Header | None = None
        self._skip = 0

    @property
    def within_message(self) -> bool:
        """True if a message has begun and not ended."""
        return self._header is not None or self._skip > 0 or len(self._buffer) > 0

    def feed(self, data: bytes) -> list[Taken]:
        """Return the messages that these bytes complete; an error replaces a refused one.

        Raises:
            WireError: the start of the next message is lost.
        """
        messages: list[Taken] = []
        self._buffer += data
        while True:
            if self._skip:
                passed = min(self._skip, len(self._buffer))
                del self._buffer[:passed]
                self._skip -= passed
                if self._skip:
                    return messages
            if self._header is None:
                if len(self._buffer) < HEADER_BYTES:
                    return messages
                self._header = self._begin()
            if not self._header.is_read:
                messages.append(self._passed_over(self._header))
                continue
            if len(self._buffer) < self._header.body_bytes:
                return messages
            messages.append(self._taken(self._header))

    def close(self) -> None:
        """Handle the peer's closing of the connection.

        Raises:
            WireError: it was closed within a message.
        """
        if self.within_message:
            raise WireError(WireProblem.CLOSED)

    def _begin(self) -> Header:
        header = decode_header(self._buffer[:HEADER_BYTES])
        del self._buffer[:HEADER_BYTES]
        return header

    def _passed_over(self, header: Header) -> Message:
        self._header, self._skip = None, header.body_bytes
        return Message(header.device, header.stamp_s, Ignored(header.kind))

    def _taken(self, header: Header) -> Taken:
        body = bytes(memoryview(self._buffer)[: header.body_bytes])
        del self._buffer[: header.body_bytes]
        self._header = None
        try:
            return decode_body(header, body)
        except WireError as error:
            return error
