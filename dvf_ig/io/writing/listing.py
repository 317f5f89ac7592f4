"""List the files of a folder that this program wrote, in a hidden file that commands keep with their outputs.

A call from Python replaces the file that it is given, as `numpy.save` does. A command replaces only files of
this program: the listing holds the SHA-256 of each file as written, and a file with another hash is a user's.
While several files are swapped, the listing marks them as unfinished: a program killed meanwhile leaves files
of two runs, which readers refuse and the next writer replaces.
"""

import hashlib
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from time import monotonic, sleep, time_ns

from dvf_ig.core.errors import OutputError, UnreadableFileError
from dvf_ig.io.provenance import in_command, is_recorded

from .place import file_place, is_temporary

LISTING = ".written_by_dvf_ig.json"
_MOST_BYTES = 4 << 20
_DEEPEST = 3
"""Deepest level of folders that are written as a whole."""
_PATIENCE_S = 2.0
"""Longest wait of a reader for a process that is swapping files, which takes milliseconds."""

_SETTLED_NS = 100_000_000
"""A file that changed more recently may change again within one step of ctime, which takes 1 to 10 ms."""


@dataclass(slots=True)
class Listing:
    """Files of one folder that this program wrote.

    Attributes:
        files: SHA-256 by name; two while a file is swapped.
        unfinished: names that are being swapped together.
    """

    files: dict[str, list[str]] = field(default_factory=dict)
    unfinished: list[str] = field(default_factory=list)

    def text(self) -> str:
        """Format the listing as JSON."""
        return json.dumps({"files": self.files, "unfinished": self.unfinished}, indent=1) + "\n"

    def holds(self, name: str, path: Path) -> bool:
        """Return whether `path` is a regular file as this program wrote it under this name."""
        return name in self.files and not path.is_symlink() and sha256(path) in self.files[name]


def read_listing(folder: Path) -> Listing:
    """Read the listing of a folder; empty if there is none, or none of ours."""
    path = folder / LISTING
    try:
        if path.is_symlink() or not path.is_file() or path.stat().st_size > _MOST_BYTES:
            return Listing()
        document = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return Listing()
    match document:
        case {"files": dict(files), "unfinished": list(unfinished)}:
            hashes = {str(name): list(map(str, one)) for name, one in files.items() if isinstance(one, list)}
            return Listing(hashes, [name for name in unfinished if isinstance(name, str) and name in hashes])
    return Listing()


def require_outputs(*paths: Path) -> None:
    """Refuse files that must not be written, before the work begins.

    Raises:
        OutputError: a folder, link, pipe or device; in a command also a file that it reads, or an existing
            file that this program did not write or that was changed since.
    """
    for number, path in enumerate(paths):
        if path in paths[:number]:
            raise OutputError(f"cannot write {path}: two results would have this name; give another ending")
        place = file_place(path)
        if not in_command() or is_temporary(place.parent) or not os.path.lexists(place):
            continue
        if is_recorded(place):
            raise OutputError(f"cannot write {path}: this command reads it; choose another name")
        if not is_ours(place):
            raise OutputError(
                f"cannot write {path}: a file of that name exists that this program did not write, or that "
                "was changed since; choose another name, or move it"
            )


def is_ours(place: Path) -> bool:
    """Return whether a file is as this program wrote it, alone or in a folder written as a whole."""
    return any(
        read_listing(folder).holds(place.relative_to(folder).as_posix(), place)
        for folder in place.parents[:_DEEPEST]
    )


def require_finished(path: Path) -> None:
    """Refuse to read a file of a set that a killed program left partly old and partly new.

    Waits for a process that is swapping them now. Changes nothing.

    Raises:
        UnreadableFileError: a program was killed while it swapped them.
    """
    folder, until_s = path.parent, monotonic() + _PATIENCE_S
    while path.name in (names := read_listing(folder).unfinished):
        if monotonic() > until_s:
            raise UnreadableFileError(
                f"{path} may be from another run than {_few(names)} in its folder: a program was "
                "killed while it replaced them; run that command again"
            )
        sleep(0.01)


def sha256(path: Path) -> str | None:
    """Hash a regular file (SHA-256); None if there is none."""
    if not path.is_file():
        return None
    status = path.stat()
    settled = time_ns() - status.st_ctime_ns > _SETTLED_NS
    hashed = _hash_once if settled else _hash_once.__wrapped__
    return hashed(path, status.st_dev, status.st_ino, status.st_size, status.st_ctime_ns)


@lru_cache(maxsize=1024)
def _hash_once(path: Path, *_state: int) -> str:
    """Hash a file once until it changes: any change of a file sets the time of its status (ctime)."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _few(names: Iterable[str]) -> str:
    listed = sorted(names)
    return ", ".join(listed[:4]) + (" …" if len(listed) > 4 else "")
