"""Write a file, several files or a folder as a whole or not at all, and never over a user's files."""

import ctypes
import errno
import os
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from dvf_ig.core.errors import OutputError
from dvf_ig.io.provenance import in_command, recorded_within

from .listing import LISTING, Listing, is_ours, read_listing, require_outputs, sha256
from .place import (
    alone_in,
    failure_reason,
    file_place,
    is_temporary,
    make_folder,
    output_place,
    temporary_folder,
)


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Provide a temporary path of the same name that replaces `path` if the block succeeds.

    Raises:
        OutputError: see `require_outputs`; or the folder is missing or not writable, or the disk is full.
    """
    require_outputs(path)
    place = file_place(path)
    with _wrapped(path, place), files_together(place.parent) as new:
        yield new / place.name


def write_bytes(path: Path, data: bytes | list[bytes]) -> None:
    """Write bytes, or several blocks in order, atomically."""
    with atomic_file(path) as temporary:
        _write(temporary, data)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text with Unix line ends atomically."""
    write_bytes(path, text.encode("utf-8"))


def write_own(path: Path, data: bytes | list[bytes]) -> None:
    """Write a file of a folder that only this program uses, such as its cache, over any existing file."""
    place = file_place(path)
    with _wrapped(path, place), temporary_folder(place.parent) as new:
        _write(new / place.name, data)
        swap_all([(new / place.name, place)])


@contextmanager
def output_folder(folder: Path, names: Collection[str] = ()) -> Iterator[Path]:
    """Provide an output folder, made before the work begins so that an unusable one is refused at once.

    If the block fails before it has written anything, the folders made here are removed.

    Args:
        folder: made with its parents.
        names: files that will be written in it.
    Raises:
        OutputError: a file or link is in the way, a file must not be replaced (`require_outputs`), or not
            permitted.
    """
    created = [path for path in (folder, *folder.parents) if not os.path.exists(path)]
    make_folder(folder)
    try:
        require_outputs(*(folder / name for name in names))
        yield folder
    finally:
        for path in created:
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()


@contextmanager
def files_together(folder: Path, names: Collection[str] | None = None) -> Iterator[Path]:
    """Provide a temporary folder whose files replace those in `folder` if the block succeeds: all, or none.

    Processes that write into one folder take turns, so that its files come from one of them.

    Args:
        folder: an existing folder.
        names: every file that may be written; those that the block does not write are removed from `folder`,
            so that no results of an earlier run remain. None: those that it writes.
    Raises:
        OutputError: see `require_outputs`; or not writable.
    """
    place = output_place(folder)
    if is_temporary(place):
        yield place
        return
    with _wrapped(folder, place / "file"), temporary_folder(place) as new:
        yield new
        unique = list(dict.fromkeys(names)) if names is not None else sorted(p.name for p in new.iterdir())
        with alone_in(place):
            require_outputs(*(folder / name for name in unique))
            _take_places(new, place, unique)


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """Provide a temporary folder that replaces `folder` if the block succeeds.

    An existing folder is replaced only if it is empty, or holds only files that this program wrote.

    Args:
        folder: its parents are made.
    Raises:
        OutputError: the folder holds other files or a file that is read, is a link or the working
            directory, or cannot be written.
    """
    place = output_place(folder)
    with _wrapped(folder, place):
        _require_replaceable(folder, place)
        with temporary_folder(make_folder(place.parent)) as temporary:
            new = temporary / place.name
            new.mkdir()
            yield new
            files = {
                path.relative_to(new).as_posix(): [str(sha256(path))]
                for path in sorted(new.rglob("*"))
                if path.is_file()
            }
            (new / LISTING).write_text(Listing(files).text())
            _require_replaceable(folder, place)
            swap_all([(new, place)])


def _take_places(new: Path, place: Path, names: list[str]) -> None:
    """Swap the files of `new` into `place`, and list them if a command writes them.

    Until all are swapped, the listing marks them as unfinished. Both listings are written before the swap, so
    that a full disk cannot stop it half-way; they hold the hashes of old and new files, valid for either
    outcome.
    """
    pairs = [(new / name, place / name) for name in names]
    if not in_command():
        swap_all(pairs)
        return
    before = read_listing(place)
    files = {name: hashes for name, hashes in before.files.items() if (place / name).exists()}
    for name in names:
        files[name] = [one for path in (new, place) if (one := sha256(path / name)) is not None]
    others = [name for name in before.unfinished if name not in names]
    during, after = new / f"{LISTING}.during", new / f"{LISTING}.after"
    during.write_text(Listing(files, [*others, *(names if len(names) > 1 else [])]).text())
    after.write_text(Listing(files, others).text())
    during.replace(place / LISTING)
    try:
        swap_all(pairs)
    finally:
        after.replace(place / LISTING)


def _require_replaceable(folder: Path, place: Path) -> None:
    if place.exists() and not place.is_dir():
        raise OutputError(f"cannot write {folder}: a file of that name exists; choose another folder")
    if Path.cwd().is_relative_to(place):
        raise OutputError(f"cannot write {folder}: it holds the working directory; name another folder")
    read = recorded_within(place)
    if read is not None:
        raise OutputError(f"cannot write {folder}: this command reads {read} in it; choose another folder")
    foreign = foreign_file(place) if place.is_dir() else None
    if foreign is not None:
        raise OutputError(
            f"cannot write {folder}: it is not empty, and '{foreign}' in it was not written by this program "
            "or was changed since; choose another folder or empty it"
        )


def foreign_file(folder: Path) -> str | None:
    """Return a file or link that this program did not write, or that was changed since; None without one."""
    for path in sorted(path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()):
        listing = path.name == LISTING and not path.is_symlink() and bool(read_listing(path.parent).files)
        if not (listing or is_ours(path)):
            return path.relative_to(folder).as_posix()
    return None


def _write(path: Path, data: bytes | list[bytes]) -> None:
    with path.open("wb") as stream:
        stream.writelines(data if isinstance(data, list) else [data])


@contextmanager
def _wrapped(path: Path, place: Path) -> Iterator[None]:
    """Convert a file-system error to a sentence about the output that the user named."""
    try:
        yield
    except OSError as exc:
        raise OutputError(f"cannot write {path}: {failure_reason(exc, place)}") from exc


_Node = tuple[int, int] | None
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_UNSUPPORTED = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EPERM)


def swap_all(pairs: list[tuple[Path, Path]]) -> None:
    """Swap each first path with each second one, or none; a missing first path removes the second.

    One pair is swapped in a single step if the file system has one (renameat2 of Linux), so that a killed
    process leaves either the old or the new; otherwise by renames. On any exception, pairs that were already
    swapped are swapped back.
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
