"""Write a file whole or not at all: build it beside its place, then rename; folders to write into."""

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from dvf_ig.core.errors import OutputError


def output_place(path: Path) -> Path:
    """Where an output really goes: `path` without symbolic links.

    Raises:
        OutputError: no name that a file can have, or links in a circle.
    """
    if "\0" in str(path):
        raise OutputError(f"cannot write {str(path)!r}: a file's name cannot hold a NUL; give another")
    try:
        return path.resolve()
    except (OSError, RuntimeError) as exc:
        raise OutputError(f"cannot write {path}: its links lead nowhere ({exc})") from exc


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` (same suffixes) that replaces it when the block ends well.

    Of a symbolic link, the file that it points to is replaced.

    Raises:
        OutputError: the folder is missing or not writable, the disk is full, or the target is a folder or a
            device.
    """
    place = output_place(path)
    temporary = place.with_name(f".{uuid.uuid4().hex[:8]}.{place.name}")
    try:
        if place.is_dir():
            raise OutputError(f"cannot write {path}: it is a folder; give a file name")
        if place.exists() and not place.is_file():
            raise OutputError(f"cannot write {path}: it is a device or a pipe; give the name of a file")
        yield temporary
        os.replace(temporary, place)
    except OSError as exc:
        raise OutputError(f"cannot write {path}: {failure_reason(exc, place)}") from exc
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_bytes(path: Path, data: bytes | list[bytes]) -> None:
    """Write bytes (or several blocks one after the other) atomically."""
    with atomic_file(path) as temporary, temporary.open("wb") as stream:
        for block in data if isinstance(data, list) else [data]:
            stream.write(block)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text with Unix line ends atomically."""
    write_bytes(path, text.encode("utf-8"))


def make_folder(folder: Path) -> None:
    """Make a folder and its parents where they are missing.

    Raises:
        OutputError: a file is in the way, or not permitted.
    """
    try:
        output_place(folder).mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise OutputError(f"cannot make the folder {folder}: {exc.strerror or exc}") from exc


@contextmanager
def output_folder(folder: Path) -> Iterator[Path]:
    """A folder to write results into, made before the work begins so that a bad place is refused at once.

    When the block fails before it has written anything, folders that were made here are removed again.

    Raises:
        OutputError: a file is in the way, or not permitted.
    """
    made = [p for p in (folder, *folder.parents) if not os.path.exists(p)]
    make_folder(folder)
    try:
        yield folder
    finally:
        for path in made:
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()


def failure_reason(exc: OSError, path: Path) -> str:
    """Why `path` cannot be written, in words."""
    if isinstance(exc, FileNotFoundError) and not path.parent.is_dir():
        return f"the folder {path.parent} does not exist; make it first"
    return exc.strerror or str(exc)
