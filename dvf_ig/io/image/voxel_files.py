"""Locate the voxel files of an image whose voxels are not in the file that was named."""

import re
from collections.abc import Callable
from pathlib import Path

from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.io.file_within import file_within

MOST_FILES = 1 << 16
_PATTERN = re.compile(r"(\S*)%0?(\d?)d(\S*)[ \t]+(\d{1,9})[ \t]+(\d{1,9})(?:[ \t]+(\d{1,9}))?(?:[ \t]+\d)?")


def named_voxel_files(header: Path, name: str, rest: Callable[[], str]) -> tuple[Path, ...]:
    """List the separate voxel files of an image, in order; empty if the voxels follow the header.

    MetaImage and NRRD both name one file, a pattern with numbers ("slice%03d.raw 1 20 1"), or LIST followed
    by one name per line.

    Args:
        header: the file that names them.
        name: as written in the header.
        rest: the text after the name.
    Raises:
        UnreadableFileError: a file is absent, is not a file, or is not in the header's folder; or too many.
    """
    if name.upper() == "LOCAL":
        return ()
    match = _PATTERN.fullmatch(name)
    if re.fullmatch(r"LIST(\s+\d)?", name.upper()):
        names = [line.strip() for line in rest().splitlines() if line.strip()]
    elif match is not None:
        names = _numbered(header, match)
    else:
        names = [name]
    if not 0 < len(names) <= MOST_FILES:
        raise UnreadableFileError(f"{header} names {len(names)} files of voxels; needed 1 to {MOST_FILES}")
    return tuple(file_within(header.parent, one, header) for one in names)


def _numbered(header: Path, pattern: re.Match[str]) -> list[str]:
    """Expand a pattern with first, last and step into names."""
    before, width, after = pattern[1], int(pattern[2] or 0), pattern[3]
    numbers = range(int(pattern[4]), int(pattern[5]) + 1, max(int(pattern[6] or 1), 1))
    if len(numbers) > MOST_FILES:
        raise UnreadableFileError(f"{header} names {len(numbers)} files of voxels; needed 1 to {MOST_FILES}")
    return [f"{before}{n:0{width}d}{after}" for n in numbers]
