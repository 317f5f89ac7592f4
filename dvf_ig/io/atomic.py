"""Write a file or a folder whole or not at all: build beside the target, then rename."""

import os
import shutil
import uuid
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from dvf_ig.core.errors import OutputError


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` (same suffixes) that replaces it when the block ends well.

    Raises:
        OutputError: the folder is missing or not writable, the disk is full, or the target is a folder.
    """
    temporary = path.with_name(f".{uuid.uuid4().hex[:8]}.{path.name}")
    try:
        if path.is_dir():
            raise OutputError(f"cannot write {path}: it is a folder; give a file name")
        yield temporary
        os.replace(temporary, path)
    except OSError as exc:
        raise OutputError(f"cannot write {path}: {_reason(exc, path)}") from exc
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
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise OutputError(f"cannot make the folder {folder}: {exc.strerror or exc}") from exc


@contextmanager
def output_folder(folder: Path) -> Iterator[Path]:
    """A folder to write results into, made before the work begins so that a bad place is refused at once.

    When the block fails before it has written anything, folders that were made here are removed again.

    Raises:
        OutputError: a file is in the way, or not permitted.
    """
    made = [p for p in (folder, *folder.parents) if not p.exists()]
    make_folder(folder)
    try:
        yield folder
    finally:
        for path in made:
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()


@contextmanager
def files_together(folder: Path, names: Collection[str]) -> Iterator[Path]:
    """A temporary folder whose files take their places in `folder` when the block ends well: all, or none.

    Args:
        folder: exists.
        names: every file that may be written; those that the block leaves out are removed from `folder`, so
            that nothing of an earlier run lies beside the results of this one.
    Raises:
        OutputError: not writable, or a folder has the name of a file.
    """
    temporary = folder / f".{uuid.uuid4().hex[:8]}"
    new, old = temporary / "new", temporary / "old"
    moved: list[str] = []
    try:
        new.mkdir(parents=True)
        old.mkdir()
        yield new
        for name in names:
            if (folder / name).is_dir():
                raise OutputError(f"cannot write {folder / name}: it is a folder; choose another output")
        for name in names:
            moved.append(name)
            if (folder / name).exists():
                os.replace(folder / name, old / name)
            if (new / name).exists():
                os.replace(new / name, folder / name)
    except OSError as exc:
        for name in moved:
            (folder / name).unlink(missing_ok=True)
            if (old / name).exists():
                os.replace(old / name, folder / name)
        raise OutputError(f"cannot write into {folder}: {_reason(exc, folder / 'file')}") from exc
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def atomic_folder(folder: Path, may_replace: Callable[[Path], bool]) -> Iterator[Path]:
    """A temporary folder beside `folder` that takes its place when the block ends well.

    Args:
        folder: target; its parents are made.
        may_replace: asked about an existing, non-empty target; False refuses to write.
    Raises:
        OutputError: the target holds something else, or cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"cannot write {folder}: a file of that name exists; choose another folder")
    if folder.is_dir() and any(folder.iterdir()) and not may_replace(folder):
        raise OutputError(
            f"cannot write {folder}: it is not empty and was not written by this program; "
            "choose another folder or empty it"
        )
    temporary = folder.with_name(f".{uuid.uuid4().hex[:8]}.{folder.name}")
    old = temporary.with_name(temporary.name + ".old")
    try:
        temporary.mkdir(parents=True)
        yield temporary
        if folder.exists():
            os.replace(folder, old)
        os.replace(temporary, folder)
    except OSError as exc:
        if old.exists() and not folder.exists():
            os.replace(old, folder)
        raise OutputError(f"cannot write {folder}: {_reason(exc, folder)}") from exc
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def _reason(exc: OSError, path: Path) -> str:
    if isinstance(exc, FileNotFoundError) and not path.parent.is_dir():
        return f"the folder {path.parent} does not exist; make it first"
    return exc.strerror or str(exc)
