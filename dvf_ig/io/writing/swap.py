"""Paths that change places: all pairs, or none.

One pair changes places in a single step of the file system where it has one (renameat2 of Linux), so that a
process that is killed leaves the old or the new; elsewhere by renames, which are undone when anything stops
them.
"""

import ctypes
import errno
import os
from pathlib import Path

_Node = tuple[int, int] | None
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_UNSUPPORTED = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EPERM)


def swap_all(pairs: list[tuple[Path, Path]]) -> None:
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
