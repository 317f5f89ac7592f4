"""Arrays of an `.npz` archive: none of objects, and none that unpacks to more than it may."""

import ast
import io
import zipfile
import zlib
from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import AnyArray
from dvf_ig.core.errors import UnreadableFileError

_KINDS = "biuf"


def read_npz(path: Path, data: bytes, most_bytes: int) -> dict[str, AnyArray]:
    """Every array by its name.

    Args:
        path: named in errors.
        data: the archive.
        most_bytes: of all arrays together.
    Raises:
        UnreadableFileError: damaged, more than `most_bytes`, or an array of something else than numbers.
    """
    arrays: dict[str, AnyArray] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            total = sum(member.file_size for member in members)
            if total > most_bytes or len(members) > 1000:
                raise UnreadableFileError(
                    f"{path} states {total} bytes in {len(members)} arrays; at most {most_bytes} are read"
                )
            for member in members:
                with archive.open(member) as stream:
                    content = stream.read(member.file_size + 1)
                arrays[member.filename.removesuffix(".npy")] = _array(content)
    except (zipfile.BadZipFile, zlib.error, OSError, RuntimeError, NotImplementedError, EOFError) as exc:
        raise UnreadableFileError(
            f"{path} is not a readable archive of arrays ({exc}); write it again"
        ) from exc
    except (ValueError, TypeError, LookupError, SyntaxError, UnicodeError, RecursionError) as exc:
        if isinstance(exc, UnreadableFileError):
            raise
        raise UnreadableFileError(f"{path} holds an array that is damaged ({exc}); write it again") from exc
    return arrays


def _array(content: bytes) -> AnyArray:
    """Source: numpy.lib.format, versions 1.0 to 3.0."""
    if content[:6] != b"\x93NUMPY" or len(content) < 12 or content[6] not in (1, 2, 3):
        raise ValueError("it does not begin as one")
    width = 2 if content[6] == 1 else 4
    begin = 8 + width + int.from_bytes(content[8 : 8 + width], "little")
    if begin > min(len(content), 10_000):
        raise ValueError("its header is too long")
    header = ast.literal_eval(content[8 + width : begin].decode("utf-8"))
    dtype, shape = np.dtype(header["descr"]), tuple(int(size) for size in header["shape"])
    if dtype.kind not in _KINDS or dtype.names is not None or min(shape, default=0) < 0 or len(shape) > 8:
        raise ValueError(f"it holds {header['descr']!r} in the shape {shape}")
    count = 1
    for size in shape:
        count *= size
    if count * dtype.itemsize != len(content) - begin:
        raise ValueError(f"its shape {shape} does not fit its {len(content) - begin} bytes")
    flat = np.frombuffer(content, dtype, count, begin)
    return flat.reshape(shape, order="F" if header["fortran_order"] else "C")
