"""Bytes of a zlib or gzip stream, as many as a header promises; memory is taken for no more than those.

zlib-ng unpacks images in half the time of Python's own zlib, as ITK does.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from zlib_ng import zlib_ng

from dvf_ig.core.errors import UnreadableFileError

MOST_PACKED = 1032
"""Bytes that one byte of a deflate stream can stand for (RFC 1951: 258 in two bits)."""
_GZIP_OR_ZLIB = 47
"""zlib's "detect the header" window size."""
_GZIP = b"\x1f\x8b"
_STEP = 4096
"""Packed bytes a step: what they stand for, at most 4 MB, is copied while it is in the processor's cache."""


def inflated(path: Path, packed: Any, needed: int, *, more: bool = False) -> NDArray[np.uint8]:
    """(needed,) bytes, read-only, of a stream that is checked to its end.

    Args:
        path: the file, for messages.
        packed: the stream, a buffer of bytes; gzip may hold several members one after the other.
        needed: how many bytes the header promises.
        more: the stream may hold more, of which nothing is read.
    Raises:
        UnreadableFileError: it is damaged or does not end, or it holds another number of bytes.
    """
    if needed > len(packed) * MOST_PACKED:
        require_size(path, len(packed), needed)
    out, at = np.empty(needed, np.uint8), 0
    try:
        for block in _blocks(path, memoryview(packed)):
            if at + len(block) > needed and not more:
                require_size(path, at + len(block), needed)
            part = np.frombuffer(block, np.uint8)[: needed - at]
            out[at : at + len(part)] = part
            at += len(part)
            if len(part) < len(block):
                break
    except zlib_ng.error as exc:  # type: ignore[misc]  # its stub calls the class an instance
        raise UnreadableFileError(
            f"{path}: its packed image data are damaged ({exc}); copy it again"
        ) from exc
    require_size(path, at, needed)
    out.setflags(write=False)
    return out


def _blocks(path: Path, packed: memoryview) -> Iterator[bytes]:
    """What each step of the stream unpacks to, until it ends."""
    inflater = zlib_ng.decompressobj(_GZIP_OR_ZLIB)
    begin = 0
    while begin < len(packed):
        yield inflater.decompress(packed[begin : begin + _STEP])
        begin += _STEP
        if inflater.eof:
            begin = min(begin, len(packed)) - len(inflater.unused_data)
            if packed[begin : begin + 2] != _GZIP:
                return
            inflater = zlib_ng.decompressobj(_GZIP_OR_ZLIB)
    raise UnreadableFileError(
        f"{path} is truncated: its packed image data do not end; copy or record it again"
    )


def require_size(path: Path, got: int, needed: int) -> None:
    """Refuse another number of bytes than needed.

    Raises:
        UnreadableFileError: says which.
    """
    if got != needed:
        state = "is truncated" if got < needed else "is longer than its header says"
        raise UnreadableFileError(
            f"{path} {state}: its image data have {max(got, 0)} bytes, its header needs {needed}; copy it "
            "again"
        )
