"""Check output paths, and make the temporary folder in which output is written.

A temporary folder is `.dvf_ig-XXXXXXXX` in the output's folder. It is locked while in use, so that one left
by a killed program can be recognised; such a folder is reported, never removed.
"""

import fcntl
import logging
import os
import re
import shutil
import stat
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from dvf_ig.core.errors import OutputError

TEMPORARY = re.compile(r"\.dvf_ig-[0-9a-f]{8}")
_LOG = logging.getLogger(__name__)
_in_use: set[Path] = set()
_warned: set[Path] = set()
_YOUNG_S = 1.0
"""Age below which a temporary folder may not be locked yet."""


def output_place(path: Path) -> Path:
    """Resolve the links of the folder of `path`; the path itself must not be a link.

    Raises:
        OutputError: an invalid file name, a link, a pipe or a device.
    """
    if "\0" in str(path):
        raise OutputError(f"cannot write {str(path)!r}: a file's name cannot hold a NUL; give another")
    try:
        if path.is_symlink():
            raise OutputError(
                f"cannot write {path}: it is a link to {os.readlink(path)}; name the file or folder itself"
            )
        place = path.resolve()
        if place.exists() and not (place.is_file() or place.is_dir()):
            raise OutputError(f"cannot write {path}: it is a device or a pipe; give the name of a file")
    except (OSError, RuntimeError) as exc:
        reason = exc.strerror if isinstance(exc, OSError) else None
        raise OutputError(f"cannot write {path}: {reason or exc}") from exc
    return place


def file_place(path: Path) -> Path:
    """Resolve the path of an output file.

    Raises:
        OutputError: as `output_place`, or a folder.
    """
    place = output_place(path)
    if place.is_dir():
        raise OutputError(f"cannot write {path}: it is a folder; give a file name")
    return place


def require_folder(path: Path) -> None:
    """Refuse an output folder that is not a folder, before the work begins.

    Raises:
        OutputError: as `output_place`, or a file.
    """
    if output_place(path).is_file():
        raise OutputError(f"cannot write into {path}: it is a file; name a folder")


def make_folder(folder: Path) -> Path:
    """Make a folder and its missing parents, and return its resolved path.

    Raises:
        OutputError: a file or a link is in the way, or not permitted.
    """
    place = output_place(folder)
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise OutputError(f"cannot make the folder {folder}: {exc.strerror or exc}") from exc
    return place


@contextmanager
def temporary_folder(parent: Path) -> Iterator[Path]:
    """Provide a locked temporary folder in `parent`, removed at the end.

    Raises:
        OSError: `parent` is missing or cannot be written.
    """
    new = parent / f".dvf_ig-{uuid.uuid4().hex[:8]}"
    new.mkdir()
    with alone_in(new):
        _in_use.add(new)
        try:
            _name_leftovers(parent)
            yield new
        finally:
            _in_use.discard(new)
            shutil.rmtree(new, ignore_errors=True)


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Provide a folder in the system's temporary folder for files that are not output."""
    with TemporaryDirectory(prefix="dvf_ig_") as name:
        folder = Path(name).resolve()
        _in_use.add(folder)
        try:
            yield folder
        finally:
            _in_use.discard(folder)


def is_temporary(folder: Path) -> bool:
    """Return whether `folder` is in a temporary folder of this process."""
    return not _in_use.isdisjoint((folder, *folder.parents))


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Lock a folder against other processes of this program; does nothing if it cannot be locked (NFS)."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def failure_reason(exc: OSError, path: Path) -> str:
    """Describe why `path` cannot be written."""
    if isinstance(exc, FileNotFoundError) and not path.parent.is_dir():
        return f"the folder {path.parent} does not exist; make it first"
    return exc.strerror or str(exc)


def _name_leftovers(parent: Path) -> None:
    """Warn once of each temporary folder left by a killed program."""
    for path in parent.iterdir():
        if TEMPORARY.fullmatch(path.name) and path not in _warned and _is_leftover(path):
            _warned.add(path)
            size = sum(one.lstat().st_size for one in path.rglob("*") if one.is_file())
            _LOG.warning(
                f"{path} ({size / 1e6:.1f} MB) was left by a program that was killed while it wrote; "
                f"nothing uses it, remove it with: rm -r '{path}'"
            )


def _is_leftover(path: Path) -> bool:
    """Return whether a folder of this user has a temporary name and no process holds its lock."""
    try:
        status = path.lstat()
        if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or path in _in_use:
            return False
        if time.time() - status.st_mtime < _YOUNG_S:
            return False
        handle = os.open(path, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    finally:
        os.close(handle)
    return True
