"""Wrap every failure while reading a file in one sentence that names it; record the files that were read."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dvf_ig.core.errors import InvalidInputError, UnreadableFileError

from .limits import FILE_BYTES, TEXT_BYTES
from .provenance import file_stamp, record_file, record_folder
from .writing.listing import require_finished

_LFS_POINTER = b"version https://git-lfs.github.com/spec/"


def refuse_lfs_pointer(path: Path) -> None:
    """Refuse the short text that Git-LFS leaves in place of a large file that was not downloaded.

    Source: git-lfs docs/spec.md, "The Pointer".

    Raises:
        UnreadableFileError: `path` is such a pointer.
    """
    try:
        if not path.is_file():
            return
        with path.open("rb") as file:
            head = file.read(len(_LFS_POINTER))
    except OSError:
        return  # the reader of the file reports why it cannot be opened
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
    """Read a whole file as UTF-8 text without a byte-order mark.

    Args:
        most: largest size in bytes.
    """
    with reading(path, what):
        _require_size(path, path.stat().st_size, most)
        return read_bytes(path, what).decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")


def _require_size(path: Path, size: int, most: int) -> None:
    if size > most:
        raise UnreadableFileError(f"{path} has {size} bytes; at most {most} can be read: split it")
