"""Extended header and meta data of version 2 messages: named texts in addition to the content."""

import struct
from collections.abc import Mapping
from types import MappingProxyType

from dvf_ig.io import limits

from .message import NO_FIELDS
from .problem import WireError, WireProblem

_EXTENDED = struct.Struct(">HHII")
_COUNT = struct.Struct(">H")
_ENTRY = struct.Struct(">HHI")
_UTF8, _ASCII = 106, 3


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
        index.append(_ENTRY.pack(len(key_bytes), _UTF8, len(value_bytes)))
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
        key = _text(texts[at : at + key_bytes], _UTF8)
        at += key_bytes
        fields[key] = _text(texts[at : at + value_bytes], encoding)
        at += value_bytes
    if at != len(texts):
        raise WireError(WireProblem.SIZE)
    return MappingProxyType(fields)


def _text(raw: memoryview, encoding: int) -> str:
    """Decode a text by its MIB number.

    Raises:
        WireError: another encoding than ASCII and UTF-8, or invalid bytes.
    """
    if encoding not in (_ASCII, _UTF8):
        raise WireError(WireProblem.VALUE)
    try:
        return bytes(raw).decode("utf-8")
    except UnicodeDecodeError as exc:
        raise WireError(WireProblem.VALUE) from exc


decode_text = _text
