"""Check files that another file names: regular files in its own folder."""

import os
import stat
from pathlib import Path

from dvf_ig.core.errors import UnreadableFileError

LONGEST_NAME = 255
"""Longest file name in bytes on common file systems."""


def file_within(folder: Path, name: str, named_by: Path) -> Path:
    """Return the regular file `name` in `folder` or below it.

    Args:
        folder: that the name is relative to.
        name: as written in a header.
        named_by: the file that names it, for messages.
    Raises:
        UnreadableFileError: absent; a pipe, device or folder; or elsewhere, by its name or through a link,
            except into the folder to which `named_by` itself is a link, or a git-annex store.
    """
    path = path_within(folder, name, named_by)
    try:
        real, home = path.resolve(strict=True), folder.resolve()
        kind = real.stat().st_mode
    except FileNotFoundError as exc:
        raise UnreadableFileError(
            f"{path} does not exist, which {named_by.name} names; copy it there"
        ) from exc
    except (OSError, RuntimeError) as exc:
        raise UnreadableFileError(f"{named_by} names {name!r}, which cannot be opened ({exc})") from exc
    if not any(real.is_relative_to(folder) for folder in (home, *_stores(home, named_by))):
        raise UnreadableFileError(
            f"{named_by} names {name!r}, a link to a file outside its folder; copy the file into it"
        )
    if not stat.S_ISREG(kind):
        raise UnreadableFileError(
            f"{named_by} names {name!r}, which is not a regular file; needed one in its folder"
        )
    return path


def _stores(home: Path, named_by: Path) -> list[Path]:
    """List folders that links may lead to: that of the naming file itself, and git-annex stores around it."""
    annexes = (parent / ".git" / "annex" / "objects" for parent in (home, *home.parents))
    return [named_by.resolve().parent, *(annex for annex in annexes if annex.is_dir())]


def path_within(folder: Path, name: str, named_by: Path) -> Path:
    """Return a path in `folder` or below it, from its name alone.

    Raises:
        UnreadableFileError: an absolute name, one with "..", or one that no file can have.
    """
    parts = Path(name).parts
    long = any(len(os.fsencode(part)) > LONGEST_NAME for part in parts)
    if long or not parts or "\0" in name or Path(name).is_absolute() or ".." in parts:
        raise UnreadableFileError(
            f"{named_by} names {name[:80]!r}; needed the name of a file in its own folder, without '..': put "
            "the file there"
        )
    return folder / name
