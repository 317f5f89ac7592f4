"""Read the arrays of an uncompressed `.npz` archive: only numbers, and no larger than the archive itself.

Our files are uncompressed (`numpy.savez`). A compressed archive of 2 MB may expand to 2 GB, which a reader
notices only after it has reserved the memory.
"""

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from dvf_ig.core import AnyArray, UnreadableFileError

MOST_ARRAYS = 1000
_HEADER = re.compile(
    rb"\{'descr': '([<>|=][biuf]\d{1,2})', 'fortran_order': (True|False), "
    rb"'shape': \(((?:\d{1,18}, ?){0,8}(?:\d{1,18})?)\),? ?\} *\n?"
)
"""Header as numpy writes it, for numbers in at most eight axes."""


def read_npz(path: Path, data: bytes, most_bytes: int) -> dict[str, AnyArray]:
    """Read every array by its name.

    Args:
        path: named in errors.
        data: the archive.
        most_bytes: of all arrays together.
    Raises:
        UnreadableFileError: damaged, compressed, more than `most_bytes`, or not numbers.
    """
    arrays: dict[str, AnyArray] = {}
    with _archive(path, io.BytesIO(data), len(data), most_bytes) as archive:
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            if name in arrays:
                raise UnreadableFileError(f"{path} holds two arrays named {name[:60]!r}; write it again")
            with archive.open(member) as stream:
                arrays[name] = _array(path, name, stream.read(member.file_size + 1))
    return arrays


def require_npz_sizes(path: Path, most_bytes: int) -> None:
    """Check the directory of an archive without reading its arrays.

    Raises:
        UnreadableFileError: as `read_npz`.
    """
    with path.open("rb") as stream, _archive(path, stream, path.stat().st_size, most_bytes):
        pass


@contextmanager
def _archive(path: Path, source: IO[bytes], size: int, most_bytes: int) -> Iterator[zipfile.ZipFile]:
    """Open an archive whose directory states no more than it holds, and wrap its errors."""
    try:
        with zipfile.ZipFile(source) as archive:
            _require_sizes(path, archive.infolist(), size, most_bytes)
            yield archive
    except (
        zipfile.BadZipFile,
        zlib.error,
        struct.error,
        OSError,
        RuntimeError,
        NotImplementedError,
        EOFError,
        OverflowError,
        LookupError,
        UnicodeError,
    ) as exc:
        raise UnreadableFileError(
            f"{path} is not a readable archive of arrays ({exc}); write it again"
        ) from exc


def _require_sizes(path: Path, members: list[zipfile.ZipInfo], size: int, most_bytes: int) -> None:
    """Refuse an archive that states more than it holds, before reading it."""
    if any(member.compress_type != zipfile.ZIP_STORED for member in members):
        raise UnreadableFileError(
            f"{path} holds compressed arrays; write it again without compression (numpy.savez)"
        )
    total = sum(member.file_size for member in members)
    if total > min(most_bytes, size) or len(members) > MOST_ARRAYS:
        raise UnreadableFileError(
            f"{path} states {total} bytes in {len(members)} arrays and holds {size}; at most {most_bytes} "
            f"in {MOST_ARRAYS} can be read: write it again"
        )


def _array(path: Path, name: str, content: bytes) -> AnyArray:
    """Decode one array. Source: numpy.lib.format, versions 1.0 to 3.0."""

    def damaged(why: str) -> UnreadableFileError:
        return UnreadableFileError(
            f"{path} holds an array that is damaged ({name[:60]!r} {why}); write it again"
        )

    if content[:6] != b"\x93NUMPY" or len(content) < 12 or content[6] not in (1, 2, 3):
        raise damaged("does not begin like an array")
    width = 2 if content[6] == 1 else 4
    begin = 8 + width + int.from_bytes(content[8 : 8 + width], "little")
    if begin > min(len(content), 10_000):
        raise damaged("has a header that is too long")
    header = _HEADER.fullmatch(content[8 + width : begin])
    if header is None:
        raise damaged(f"is not of numbers: {content[8 + width : begin][:80]!r}")
    try:
        dtype = np.dtype(header[1].decode("ascii"))
    except TypeError as exc:
        raise damaged(f"has no numeric type: {exc}") from exc
    shape = tuple(int(size) for size in header[3].replace(b",", b" ").split())
    count = 1
    for size in shape:
        count *= size
    if count * dtype.itemsize != len(content) - begin or (count == 0 and max(shape) > len(content)):
        raise damaged(f"has the shape {shape}, which does not fit its {len(content) - begin} bytes")
    flat = np.frombuffer(content, dtype, count, begin)
    return flat.reshape(shape, order="F" if header[2] == b"True" else "C")
