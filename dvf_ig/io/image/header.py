"""Storage, files and geometry of voxels as the header of a MetaImage, NRRD or NIfTI file describes them."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, UnreadableFileError, read_only_arrays
from dvf_ig.io import limits
from dvf_ig.io.file_within import file_within

from .phase_times import PhaseTimes

_BLOCK = 1 << 18
_LARGEST = 1e12
"""Largest number in an image's geometry; products of larger ones overflow."""


@dataclass(frozen=True, slots=True)
class Storage:
    """Location of the voxel bytes.

    Attributes:
        files: separate files, in order; empty if the voxels follow the header.
        offset: of the voxels in the header's own file, bytes.
        skip: bytes to skip after that, or at the start of a separate file; None reads the last bytes.
        compressed: zlib or gzip.
    """

    files: tuple[Path, ...]
    offset: int
    skip: int | None = 0
    compressed: bool = False


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ImageHeader:
    """An image as its file describes it; lengths in mm, LPS.

    Attributes:
        sizes: of the stored axes, the fastest first, without the axis of values per voxel.
        dtype: of a value, with its byte order.
        values_per_voxel: more than 1 for vectors and colours.
        phase_axis: which stored axis runs over phases; None if the image is not 4-D.
        origin_mm, spacing_mm, direction: (3,), (3,), (3, 3) of the three axes in space, as stored; column a
            of `direction` is that of axis a.
        storage: where the voxels are.
        fields: every field of the header by its name.
        times: of the volumes of a 4-D image; None if the header states none.
        scaling: slope and intercept of the values; a slope of 0 means none.
    """

    sizes: tuple[int, ...]
    dtype: np.dtype[np.generic]
    values_per_voxel: int
    phase_axis: int | None
    origin_mm: FloatArray
    spacing_mm: FloatArray
    direction: FloatArray
    storage: Storage
    fields: dict[str, str] = field(default_factory=dict)
    times: PhaseTimes | None = None
    scaling: tuple[float, float] = (0.0, 0.0)

    @property
    def dimension(self) -> int:
        """Number of axes, without one of a single phase."""
        return len(self.sizes) - (self.phase_axis is not None and self.sizes[self.phase_axis] == 1)

    @property
    def bytes(self) -> int:
        """Size of all voxels, uncompressed."""
        count = self.values_per_voxel * self.dtype.itemsize
        for size in self.sizes:
            count *= size
        return count


def read_until(path: Path, end: re.Pattern[bytes]) -> tuple[bytes, re.Match[bytes] | None]:
    """Read the start of a file up to a mark, and the mark; None if HEADER_BYTES hold none."""
    data = bytearray()
    with path.open("rb") as stream:
        while len(data) <= limits.HEADER_BYTES and (block := stream.read(max(_BLOCK, len(data)))):
            begin = max(len(data) - 4096, 0)
            data += block
            if end.search(data, begin):
                break
    whole = bytes(data)
    return whole, end.search(whole)


def whole_numbers(path: Path, name: str, text: str, least: int, most: int) -> tuple[int, ...]:
    """Parse the integers of a field, each from `least` to `most`.

    Raises:
        UnreadableFileError: other values, none, or too many.
    """
    words = text.split()
    if 1 <= len(words) <= 16 and all(re.fullmatch(r"[-+]?\d{1,18}", word) for word in words):
        numbers = tuple(int(word) for word in words)
        if all(least <= number <= most for number in numbers):
            return numbers
    raise UnreadableFileError(
        f"{path}: {name} is '{text[:60]}'; needed whole numbers from {least} to {most}: copy it again"
    )


def real_numbers(path: Path, name: str, text: str, count: int) -> FloatArray:
    """Parse (count,) finite numbers of a field.

    Raises:
        UnreadableFileError: another count, or a number that is not finite.
    """
    try:
        values = np.array([float(word) for word in text.split()[: count + 1]])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not (np.abs(values) <= _LARGEST).all():
        raise UnreadableFileError(
            f"{path}: {name} is '{text[:60]}'; needed {count} finite numbers below {_LARGEST:g}"
        )
    return values


def sides_and_directions(path: Path, axes_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Split the columns of `axes_mm` into (3,) voxel sides and (3, 3) directions.

    Raises:
        UnreadableFileError: an axis without length.
    """
    sides = np.linalg.norm(axes_mm, axis=0)
    if not np.isfinite(sides).all() or (sides <= 0).any():
        raise UnreadableFileError(f"{path}: an axis of its image has no length; set its geometry again")
    return sides, axes_mm / sides


def three_dimensional(path: Path, matrix: FloatArray, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the spatial part of an (n, n) matrix and an (n,) origin; time is the last axis if n is 4.

    Raises:
        UnreadableFileError: space and time are mixed.
    """
    if len(vector) == 4 and max(np.abs(matrix[:3, 3]).max(), np.abs(matrix[3, :3]).max()) > 1e-9:
        raise UnreadableFileError(
            f"{path}: its axes of space and time are mixed; save it with a separate time axis"
        )
    return matrix[:3, :3], vector[:3]


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
