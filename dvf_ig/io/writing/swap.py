"""Swap pairs of paths: all, or none.

One pair is swapped in a single step if the file system has one (renameat2 of Linux), so that a killed process
leaves either the old or the new; otherwise by renames, which are undone on any failure.
"""

import ctypes
import errno
import os
from pathlib import Path

_Node = tuple[int, int] | None
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_UNSUPPORTED = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EPERM)


def swap_all(pairs: list[tuple[Path, Path]]) -> None:
    """Swap each first path with each second one, or none; a missing first path removes the second.

    On any exception, pairs that were already swapped are swapped back.
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
    """Swap back the pairs that were swapped; False if interrupted by a second Ctrl-C."""
    try:
        for (new, place), nodes in zip(pairs, before, strict=True):
            if (_node(new), _node(place)) != nodes:
                _swap(new, place)
    except KeyboardInterrupt:
        return False
    return True


def _swap(new: Path, place: Path) -> None:
    """Swap two paths, either of which may be missing."""
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
    """Exchange two paths in one step; False if the system or the file system cannot (renameat2(2))."""
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
    """Return the identity of the file or folder at a path."""
    try:
        status = path.lstat()
    except FileNotFoundError:
        return None
    return status.st_dev, status.st_ino
