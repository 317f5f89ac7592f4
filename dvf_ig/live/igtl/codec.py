"""Conversion between OpenIGTLink bodies and messages: pure functions, no socket."""

from collections.abc import Callable
from typing import Any

from .fields import joined_body, split_body
from .header import Header, checksum, decode_header, encode_header
from .image import decode_image, encode_image
from .message import NO_FIELDS, Content, Ignored, Image, Message, Status, Text, TrackingData, Transform
from .poses import (
    decode_position,
    decode_quaternion_tracking,
    decode_tracking,
    decode_transform,
    encode_tracking,
    encode_transform,
)
from .problem import WireError, WireProblem
from .texts import decode_status, decode_string, encode_status, encode_string

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
