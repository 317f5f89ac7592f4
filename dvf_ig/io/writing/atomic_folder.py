"""Write the files of a folder together: all of one run, whatever stops it, and no file of a user is replaced.

What takes its place does so in one step of the file system where it has one (Linux), so that a process that
is killed leaves the old or the new; elsewhere by two renames, which are undone when anything stops them.
"""

import ctypes
import errno
import hashlib
import json
import os
import shutil
import uuid
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from dvf_ig.core.errors import OutputError

from .atomic import failure_reason, make_folder, output_place, write_text
from .swap_journal import alone_in, complete_alone, journal

LISTING = ".written_by_dvf_ig.json"
"""In a folder of ours: each of its files with its SHA-256."""

_Node = tuple[int, int] | None
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_UNSUPPORTED = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EPERM)


@contextmanager
def files_together(folder: Path, names: Collection[str] | None = None) -> Iterator[Path]:
    """A temporary folder whose files take their places in `folder` when the block ends well: all, or none.

    Two processes that write into one folder do so one after the other: its files are of one of them. What a
    process that was killed left undone is done by the next that reads or writes there (`swap_journal`).

    Args:
        folder: exists.
        names: every file that may be written; those that the block leaves out are removed from `folder`, so
            that nothing of an earlier run lies beside the results of this one. None: those that it writes.
    Raises:
        OutputError: not writable, or a folder has the name of a file.
    """
    place = output_place(folder)
    new = place / f".{uuid.uuid4().hex[:8]}"
    try:
        new.mkdir()
        yield new
        unique = list(dict.fromkeys(names)) if names is not None else sorted(p.name for p in new.iterdir())
        with alone_in(place):
            complete_alone(place)
            for name in unique:
                if (place / name).is_dir():
                    raise OutputError(f"cannot write {folder / name}: it is a folder; choose another output")
            with journal(place, new, unique):
                _swap_all([(new / name, place / name) for name in unique])
    except OSError as exc:
        raise OutputError(f"cannot write into {folder}: {failure_reason(exc, place / 'file')}") from exc
    finally:
        shutil.rmtree(new, ignore_errors=True)


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """A temporary folder beside `folder` that takes its place when the block ends well.

    An existing folder is replaced where it is empty, or holds what this function wrote and nothing else: its
    listing names every file with the SHA-256 that it has. Of a symbolic link, the folder that it points to.

    Args:
        folder: target; its parents are made.
    Raises:
        OutputError: the target holds something else, is the working directory, or cannot be written.
    """
    place = output_place(folder)
    _require_replaceable(folder, place)
    temporary = place.with_name(f".{uuid.uuid4().hex[:8]}.{place.name}")
    try:
        make_folder(temporary)
        yield temporary
        write_text(temporary / LISTING, json.dumps(_hashes(temporary), indent=1, sort_keys=True) + "\n")
        _require_replaceable(folder, place)
        _swap_all([(temporary, place)])
    except OSError as exc:
        raise OutputError(f"cannot write {folder}: {failure_reason(exc, place)}") from exc
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _require_replaceable(folder: Path, place: Path) -> None:
    try:
        if place.exists() and not place.is_dir():
            raise OutputError(f"cannot write {folder}: a file of that name exists; choose another folder")
        if Path.cwd().is_relative_to(place):
            raise OutputError(f"cannot write {folder}: it holds the working directory; name another folder")
        foreign = _foreign_file(place) if place.is_dir() else None
    except OSError as exc:
        raise OutputError(f"cannot write {folder}: {failure_reason(exc, place)}") from exc
    if foreign is not None:
        raise OutputError(
            f"cannot write {folder}: it is not empty, and '{foreign}' in it was not written by this program "
            "as it is now; choose another folder or empty it"
        )


def _foreign_file(folder: Path) -> str | None:
    """A file or link that this program did not leave there, or that was changed since; None without one."""
    found = sorted(path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())
    try:
        listed = json.loads((folder / LISTING).read_bytes())
    except (OSError, ValueError, RecursionError):
        listed = {}
    for path in found:
        name = path.relative_to(folder).as_posix()
        ours = isinstance(listed, dict) and path.is_file() and not path.is_symlink() and name in listed
        if name != LISTING and not (ours and listed[name] == _sha256(path)):
            return name
    return LISTING if found and not listed else None


def _hashes(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): _sha256(path) for path in files}


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _swap_all(pairs: list[tuple[Path, Path]]) -> None:
    """Each first path and each second change places, or none: a missing first one empties the second's place.

    Whatever stops it, an exception of any kind included, those that had changed places change back.
    """
    before = [(_node(new), _node(place)) for new, place in pairs]
    try:
        for new, place in pairs:
            _swap(new, place)
    except BaseException:
        while not _undone(pairs, before):
            pass
        raise


def _undone(pairs: list[tuple[Path, Path]], before: list[tuple[_Node, _Node]]) -> bool:
    """Put back what has changed places; False where a second Ctrl-C came in between."""
    try:
        for (new, place), nodes in zip(pairs, before, strict=True):
            if (_node(new), _node(place)) != nodes:
                _swap(new, place)
    except KeyboardInterrupt:
        return False
    return True


def _swap(new: Path, place: Path) -> None:
    """What is at the two paths changes places; either may be missing."""
    if not os.path.lexists(place):
        if os.path.lexists(new):
            os.rename(new, place)
    elif not os.path.lexists(new):
        os.rename(place, new)
    elif not _exchanged(new, place):
        aside = new.with_name(f"{new.name}.old")
        try:
            os.rename(place, aside)
            os.rename(new, place)
            os.rename(aside, new)
        except BaseException:
            if not os.path.lexists(place):
                os.rename(aside, place)
            elif os.path.lexists(aside):
                os.rename(aside, new)
            raise


def _exchanged(one: Path, other: Path) -> bool:
    """Exchange two paths in one step; False where the system or the file system cannot (renameat2(2))."""
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if rename is None:
        return False
    if rename(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0:
        return True
    number = ctypes.get_errno()
    if number in _UNSUPPORTED:
        return False
    raise OSError(number, os.strerror(number), str(other))


def _node(path: Path) -> _Node:
    """Which file or folder is there."""
    try:
        found = path.lstat()
    except FileNotFoundError:
        return None
    return found.st_dev, found.st_ino
