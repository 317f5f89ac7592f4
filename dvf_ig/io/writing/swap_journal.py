"""Several files of one folder that take their places together, also where the process is killed meanwhile.

Before the first file takes its place, a journal in the folder says which will. What finds one there later, a
command that reads or writes in the folder, brings the rest to their places: by then all of them were whole.
"""

import fcntl
import json
import os
import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from dvf_ig.core.errors import OutputError

JOURNAL = ".dvf_ig_swap.json"
_FOLDER = re.compile(r"\.[0-9a-f]{8}")
_MOST_BYTES = 1 << 16


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """No other process of ours swaps files in the folder; where it cannot be locked (NFS), unguarded."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


@contextmanager
def journal(place: Path, new: Path, names: Sequence[str]) -> Iterator[None]:
    """A journal while the block swaps the files of `new` into `place`; it goes when all or none are swapped.

    Args:
        place: the folder, which is locked (`alone_in`).
        new: a folder in it with the files that take their places; names that it lacks are removed there.
    """
    path, waiting = place / JOURNAL, new / JOURNAL
    moves = {name: [_node(place / name), _node(new / name)] for name in names}
    try:
        if len(moves) > 1:
            waiting.write_text(json.dumps({"folder": new.name, "moves": moves}))
            os.rename(waiting, path)
        yield
    finally:
        path.unlink(missing_ok=True)


def complete_swap(folder: Path) -> None:
    """Bring files to their places whose program was killed while it did so; nothing where no journal is.

    Only files of this folder move, and none that was written since. A process that is at it is waited for.

    Raises:
        OutputError: the folder cannot be written, so that its files are of two runs.
    """
    if not os.path.lexists(folder / JOURNAL):
        return
    try:
        with alone_in(folder):
            complete_alone(folder)
    except OSError as exc:
        raise OutputError(
            f"{folder} holds files of two runs, because a program was killed while it wrote them, and cannot "
            f"be put in order ({exc.strerror or exc}); make it writable, or run that command again"
        ) from exc


def complete_alone(folder: Path) -> None:
    """The same by who is alone in the folder already."""
    path = folder / JOURNAL
    if os.path.lexists(path):
        _complete(folder, _read(path))
        path.unlink(missing_ok=True)


def _complete(folder: Path, said: dict[str, Any]) -> None:
    new = folder / str(said.get("folder", ""))
    if not _FOLDER.fullmatch(new.name) or new.is_symlink() or not new.is_dir():
        return
    moves = said.get("moves")
    for name, nodes in moves.items() if isinstance(moves, dict) else ():
        if not isinstance(nodes, list) or len(nodes) != 2 or Path(name).name != name or name in (".", ".."):
            continue
        old, coming = nodes
        if _node(folder / name) not in (old, None) or _node(new / name) != coming:
            continue  # in its place already, or written since
        if coming is not None:
            os.replace(new / name, folder / name)
        elif old is not None:
            (folder / name).unlink(missing_ok=True)
    shutil.rmtree(new, ignore_errors=True)


def _read(path: Path) -> dict[str, Any]:
    """What a journal of ours says; nothing where it is somebody else's, or damaged."""
    found = path.lstat()
    if path.is_symlink() or found.st_uid != os.getuid() or found.st_size > _MOST_BYTES:
        return {}
    try:
        said = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return {}
    return said if isinstance(said, dict) else {}


def _node(path: Path) -> list[int] | None:
    """Which regular file is there; None where none is."""
    if path.is_symlink() or not path.is_file():
        return None
    found = path.stat()
    return [found.st_dev, found.st_ino, found.st_mtime_ns]
