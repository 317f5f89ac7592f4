"""STATUS and STRING messages."""

import struct

from dvf_ig.io import limits

from .fields import decode_text
from .message import Status, Text
from .problem import WireError, WireProblem

_STATUS = struct.Struct(">Hq20s")
_STRING = struct.Struct(">HH")
_UTF8, _ASCII = 106, 3


def decode_status(content: memoryview) -> Status:
    """Decode a STATUS, or raise WireError if it is too short or its texts are invalid."""
    if len(content) < _STATUS.size:
        raise WireError(WireProblem.SIZE)
    code, subcode, name = _STATUS.unpack_from(content)
    text = bytes(content[_STATUS.size :]).rstrip(b"\0")
    shown = name.partition(b"\0")[0]
    return Status(code, subcode, decode_text(memoryview(shown), _UTF8), decode_text(memoryview(text), _UTF8))


def encode_status(status: Status) -> bytes:
    """Encode a STATUS, or raise WireError if a text is too long."""
    name, text = status.name.encode(), status.text.encode()
    if len(name) > 20 or len(text) >= limits.WIRE_TEXT_BYTES:
        raise WireError(WireProblem.TOO_LARGE, "STATUS")
    return _STATUS.pack(status.code, status.subcode, name) + text + b"\0"


def decode_string(content: memoryview) -> Text:
    """Decode a STRING, or raise WireError if its length is wrong or its bytes are not text."""
    if len(content) < _STRING.size:
        raise WireError(WireProblem.SIZE)
    encoding, length = _STRING.unpack_from(content)
    if length != len(content) - _STRING.size:
        raise WireError(WireProblem.SIZE)
    return Text(decode_text(content[_STRING.size :], encoding))


def encode_string(text: Text) -> bytes:
    """Encode a STRING, or raise WireError if the text is too long."""
    raw = text.text.encode()
    if len(raw) > limits.WIRE_TEXT_BYTES:
        raise WireError(WireProblem.TOO_LARGE, "STRING")
    return _STRING.pack(_ASCII if raw.isascii() else _UTF8, len(raw)) + raw
