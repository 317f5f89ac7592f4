"""The files in which an image's voxels are, where they are not in the file that was named."""

import re
from pathlib import Path

DETACHED_SUFFIXES = (".mhd", ".nhdr")
_PAIRS = {".hdr": ".img", ".img": ".hdr"}
"""Header and voxels of Analyze and two-file NIfTI; either may be opened."""
_DATA_FILE = re.compile(
    r"^(?:ElementDataFile[ \t]*=|data ?file:)[ \t]*([^\r\n]+?)[ \t]*$([^\0]*)", re.IGNORECASE | re.MULTILINE
)
_NUMBER = re.compile(r"%0?\d*d")


def voxel_files(header: Path) -> tuple[Path, ...]:
    """The separate voxel files of an image, in order; none where the voxels are in the same file.

    MetaImage and NRRD alike name one file, a pattern with numbers ("slice%03d.raw 1 20 1"), or LIST with one
    name a line below.

    Raises:
        OSError: the header cannot be read.
    """
    if header.suffix.lower() in _PAIRS:
        other = header.with_suffix(_PAIRS[header.suffix.lower()])
        return (other,) if other.is_file() else ()
    if header.suffix.lower() not in DETACHED_SUFFIXES:
        return ()
    found = _DATA_FILE.search(header.read_bytes().decode("utf-8", "replace"))
    if found is None or found[1].upper() == "LOCAL":
        return ()
    if found[1].upper().startswith("LIST"):
        names = [line.strip() for line in found[2].splitlines() if line.strip()]
    else:
        names = _numbered(found[1])
    return tuple(header.parent / name for name in names)


def _numbered(text: str) -> list[str]:
    """The names that a pattern with first, last and step stands for; one name where there is no pattern."""
    pattern, *numbers = text.split()
    if _NUMBER.search(pattern) is None or len(numbers) < 2 or not all(n.isdigit() for n in numbers[:3]):
        return [text]
    first, last = int(numbers[0]), int(numbers[1])
    step = max(int(numbers[2]), 1) if len(numbers) > 2 else 1
    return [pattern % n for n in range(first, last + 1, step)]
