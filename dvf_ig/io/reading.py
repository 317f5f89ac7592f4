"""Wrap every failure while reading a file in one sentence that names it; record the files that were read."""

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dvf_ig.core.errors import InvalidInputError, UnreadableFileError

from .limits import FILE_BYTES, TEXT_BYTES
from .provenance import file_stamp, record_file, record_folder
from .writing.listing import require_finished

log = logging.getLogger(__name__)

_LFS_POINTER = b"version https://git-lfs.github.com/spec/"
_APPLE_DOUBLE = b"\x00\x05\x16\x07"
"""First bytes of the files "._NAME" that macOS adds to archives and network drives (RFC 1740)."""
_ANSI = "cp1252"
"""Encoding of texts that Windows programs write in Western Europe."""
_CONTROL = re.compile(rb"[\x00-\x08\x0b\x0e-\x19\x1b-\x1f\x7f\x81\x8d\x8f\x90\x9d]")
"""Bytes that no text in Windows-1252 has."""


def refuse_lfs_pointer(path: Path) -> None:
    """Refuse what is not the file itself: a Git-LFS pointer, or what macOS keeps next to a file.

    Source: git-lfs docs/spec.md, "The Pointer".

    Raises:
        UnreadableFileError: `path` is one of them.
    """
    try:
        if not path.is_file():
            return
        with path.open("rb") as file:
            head = file.read(len(_LFS_POINTER))
    except OSError:
        return  # the reader of the file reports why it cannot be opened
    if head[:4] == _APPLE_DOUBLE:
        raise UnreadableFileError(
            f"{path} holds attributes that macOS keeps of a file, not the file itself; give "
            f"{path.name.removeprefix('._')}, and delete this one"
        )
    if head == _LFS_POINTER:
        raise UnreadableFileError(
            f"{path} is a Git-LFS pointer, not the file itself; download it with: git lfs pull"
        )


@contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Wrap a block that reads and interprets `path`; on success the file is recorded as an input.

    For a folder, the files read within it are recorded. Other files that a library opens must be passed to
    `record_file`.

    Args:
        path: the file or folder.
        what: the expected content with its article, for example "a tracked sequence".
    Raises:
        UnreadableFileError: the file is absent, unreadable, invalid for the value it should become, a Git-LFS
            pointer, or possibly from another run than its neighbours (`require_finished`). Errors of this
            class pass unchanged.
    """
    if "\0" in str(path):
        raise UnreadableFileError(f"{str(path)[:80]!r} is not a valid file name; needed {what}")
    refuse_lfs_pointer(path)
    try:
        if path.is_dir():
            record_folder(path)
        else:
            require_finished(path)
        before = file_stamp(path)
        yield
        if before is not None:
            record_file(path, before=before)
    except UnreadableFileError as exc:
        exc.path = exc.path or path
        raise
    except FileNotFoundError as exc:
        raise UnreadableFileError(f"{path} does not exist; needed {what}", path=path) from exc
    except OSError as exc:
        raise UnreadableFileError(f"cannot read {path} as {what}: {exc.strerror or exc}", path=path) from exc
    except UnicodeDecodeError as exc:
        raise UnreadableFileError(
            f"{path} is not {what}: it holds bytes that are not text", path=path
        ) from exc
    except InvalidInputError as exc:
        message = exc.message if exc.path == path else f"{path}: {exc.message}"
        raise UnreadableFileError(message, path=path, settings=exc.settings) from exc


def read_bytes(path: Path, what: str) -> bytes:
    """Read a whole file of at most FILE_BYTES, or a pipe of at most TEXT_BYTES."""
    with reading(path, what):
        most = FILE_BYTES if path.is_file() or path.is_dir() else TEXT_BYTES
        with path.open("rb") as stream:
            _require_size(path, path.stat().st_size, most)
            data = stream.read() if most == FILE_BYTES else stream.read(most + 1)
        _require_size(path, len(data), most)
        record_file(path, data)
        return data


def read_text(path: Path, what: str, most: int = TEXT_BYTES) -> str:
    """Read a whole text file: UTF-8, UTF-16 with a byte-order mark, or Windows-1252, which is reported.

    Args:
        most: largest size in bytes.
    """
    with reading(path, what):
        _require_size(path, path.stat().st_size, most)
        text, encoding = decode_text(read_bytes(path, what))
        if encoding == _ANSI:
            log.warning("%s is not UTF-8 text; its letters are read as Windows-1252", path)
        return text


def decode_text(data: bytes) -> tuple[str, str]:
    """Decode text, with newlines as line ends, and return it with its encoding.

    Raises:
        UnicodeDecodeError: control characters in it show that it is not text.
    """
    wide = next((mark for mark in (b"\xff\xfe", b"\xfe\xff") if data.startswith(mark)), None)
    encoding = "utf-16" if wide is not None else "utf-8-sig"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        if wide is not None or _CONTROL.search(data):
            raise
        encoding = _ANSI
        text = data.decode(_ANSI)
    return text.replace("\r\n", "\n").replace("\r", "\n"), encoding


def _require_size(path: Path, size: int, most: int) -> None:
    if size > most:
        raise UnreadableFileError(f"{path} has {size} bytes; at most {most} can be read: split it")
