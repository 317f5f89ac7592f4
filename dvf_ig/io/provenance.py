"""Record the origin of a result: the versions it was computed with, and the files read for it.

A command opens a record; `reading` adds every file to it, with the SHA-256 of its content. Outside a command
nothing is recorded. Names are those that the user gave: an absolute path is shortened to the path within the
given folder, or to the file's own name.

Files that this program wrote carry its mark: the field `written_by` in JSON, with the kind of content, and a
comment in XML, HTML and the header of a sequence.
"""

import hashlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import dvf_ig
from dvf_ig.core.errors import UnreadableFileError

MARK = "dvf_ig"
MARKUP_COMMENT = f" written by {MARK} "
SEQUENCE_COMMENT = f"written by {MARK}"

LIBRARIES = (
    "numpy",
    "scipy",
    "numba",
    "SimpleITK",
    "scikit-image",
    "opencv-contrib-python-headless",
    "open3d",
)
"""Libraries whose versions affect results."""


_Stamp = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class _InputFile:
    path: Path
    sha256: str
    bytes: int


class _Record:
    """Files that one command has read, in order of reading.

    Attributes:
        files: by stamp, so that none is hashed twice; a pipe by its name.
        folders: given as a whole, for example a scenario.
    """

    def __init__(self) -> None:
        self.files: dict[_Stamp | Path, _InputFile] = {}
        self.folders: list[Path] = []


_RECORD: ContextVar[_Record | None] = ContextVar("files that were read", default=None)


@contextmanager
def recorded_inputs() -> Iterator[None]:
    """Record the files that are read within the block."""
    token = _RECORD.set(_Record())
    try:
        yield
    finally:
        _RECORD.reset(token)


@contextmanager
def not_recorded() -> Iterator[None]:
    """Read within the block without recording: the program's own files are not inputs."""
    token = _RECORD.set(None)
    try:
        yield
    finally:
        _RECORD.reset(token)


def file_stamp(path: Path) -> _Stamp | None:
    """Return device, node, size and modification time of a regular file; None for anything else."""
    now = path.stat() if path.is_file() else None
    return None if now is None else (now.st_dev, now.st_ino, now.st_size, now.st_mtime_ns)


def record_file(path: Path, content: bytes | None = None, before: _Stamp | None = None) -> None:
    """Add a file that was read to the open record, if there is one.

    Args:
        path: as it was opened.
        content: what was read; None reads it here, for files that a library opens itself.
        before: its stamp before the library read it.
    Raises:
        UnreadableFileError: the file has changed, is gone, or cannot be read again.
    """
    record = _RECORD.get()
    if record is None:
        return
    try:
        key = file_stamp(path) or path
        if before not in (None, key):
            raise UnreadableFileError(f"{path} changed while it was read; try again when it is complete")
        if key in record.files:
            return
        if content is not None:
            digest, size = hashlib.sha256(content), len(content)
        else:
            with path.open("rb") as stream:
                digest = hashlib.file_digest(stream, "sha256")
                size = stream.tell()
    except OSError as exc:
        raise UnreadableFileError(f"cannot read {path} again: {exc.strerror or exc}") from exc
    record.files[key] = _InputFile(path, digest.hexdigest(), size)


def in_command() -> bool:
    """Return whether a record is open: a command runs, and protects the files of its user."""
    return _RECORD.get() is not None


def is_recorded(path: Path) -> bool:
    """Return whether a file was read under the open record, by this or another name."""
    record, stamp = _RECORD.get(), file_stamp(path)
    if record is None or stamp is None:
        return False
    return any(isinstance(key, tuple) and key[:2] == stamp[:2] for key in record.files)


def recorded_within(folder: Path) -> Path | None:
    """Return a file in `folder` that was read under the open record, or None."""
    record = _RECORD.get()
    files = () if record is None else record.files.values()
    return next((one.path for one in files if one.path.resolve().is_relative_to(folder)), None)


def record_folder(folder: Path) -> None:
    """Add a folder that was given as a whole: its files are named relative to it."""
    record = _RECORD.get()
    if record is not None and folder not in record.folders:
        record.folders.append(folder)


def provenance_fields() -> dict[str, Any]:
    """Return `versions`, and `inputs` with `file`, `sha256` and `bytes` of each; empty without a record."""
    record = _RECORD.get()
    if record is None:
        return {}
    files = (
        {"file": _name(one.path, record.folders), "sha256": one.sha256, "bytes": one.bytes}
        for one in record.files.values()
    )
    return {"versions": versions(), "inputs": list(files)}


@cache
def versions() -> dict[str, str | None]:
    """Return the versions of this program, Python and the libraries; None for one that is not installed."""
    python = ".".join(map(str, sys.version_info[:3]))
    return {"dvf_ig": dvf_ig.__version__, "python": python, **{name: _version(name) for name in LIBRARIES}}


def _version(distribution: str) -> str | None:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


def _name(path: Path, folders: list[Path]) -> str:
    if not path.is_absolute():
        return path.as_posix()
    within = [path.relative_to(folder) for folder in folders if path.is_relative_to(folder)]
    return min(within, key=lambda place: len(place.parts), default=Path(path.name)).as_posix()
