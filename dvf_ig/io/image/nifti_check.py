"""Refuse NIfTI files that ITK reads wrongly: sheared voxel axes (replaced silently) and truncated voxels."""

import gzip
import math
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core import read_only_arrays
from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import UnreadableFileError

TOLERANCE = 1e-3
_FIELDS = {
    348: (("8h", 40), ("h", 72), ("f", 108), ("h", 254), ("12f", 280)),
    540: (("8q", 16), ("h", 14), ("q", 168), ("i", 348), ("12d", 400)),
}
"""By header size (NIfTI-1, -2): form and position of dim, bitpix, vox_offset, sform_code and srow_x…z."""

_BLOCK = 1 << 20


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Header:
    """What matters here of a NIfTI-1 or -2 header: the sform's (3, 3) axes or None, and the bytes needed."""

    axes: FloatArray | None
    needed_bytes: int


def check_nifti(path: Path) -> None:
    """Check a NIfTI file; files of other formats pass unread.

    Raises:
        UnreadableFileError: not NIfTI, truncated, or an sform (where its code is set) whose axes are not
            orthogonal; then the message holds a command that repairs the file.
    """
    if not path.name.lower().endswith((".nii", ".nii.gz")):
        return
    start, size = _start_and_size(path)
    header = _parse(path, start)
    if header.axes is not None:
        _require_orthogonal(path, header.axes)
    if size < header.needed_bytes:
        raise UnreadableFileError(
            f"{path} is truncated: it has {size} bytes, its header needs {header.needed_bytes}; copy it again"
        )


def _require_orthogonal(path: Path, axes: FloatArray) -> None:
    length = np.linalg.norm(axes, axis=0)
    if not np.isfinite(axes).all() or (length == 0).any():
        raise UnreadableFileError(f"{path}: an axis of its sform has no length; set its geometry again")
    unit = axes / length
    shear = float(np.abs(unit.T @ unit - np.eye(3)).max())
    if shear > TOLERANCE:
        raise UnreadableFileError(
            f"{path}: the image axes are sheared ({np.degrees(np.arcsin(min(shear, 1.0))):.2f}° off "
            f"orthogonal in its sform); resample it with: nib-conform {path.name} straight_{path.name} "
            "--voxel-size 1 1 1"
        )


def _start_and_size(path: Path) -> tuple[bytes, int]:
    """The first bytes of a file and its size, both as they are when unpacked."""
    with path.open("rb") as stream:
        packed = stream.read(2) == b"\x1f\x8b"
    try:
        with gzip.open(path) if packed else path.open("rb") as stream:
            start = stream.read(_BLOCK)
            size = len(start)
            while block := stream.read(_BLOCK):
                size += len(block)
    except (gzip.BadGzipFile, EOFError, zlib.error) as exc:
        raise UnreadableFileError(f"{path} is truncated or damaged ({exc}); copy it again") from exc
    return start, size


def _parse(path: Path, start: bytes) -> _Header:
    for order in "<>":
        stated = struct.unpack_from(f"{order}i", start)[0] if len(start) >= 4 else 0
        if len(start) < stated or stated not in _FIELDS:
            continue
        dims, (bits,), (offset,), (code,), rows = (
            struct.unpack_from(order + form, start, at) for form, at in _FIELDS[stated]
        )
        if not 1 <= dims[0] <= 7 or min(dims[1 : dims[0] + 1]) < 1 or not math.isfinite(offset):
            raise UnreadableFileError(
                f"{path}: its NIfTI header states the sizes {list(dims)}; copy it again"
            )
        needed = int(offset) + math.prod(dims[1 : dims[0] + 1]) * bits // 8
        axes = np.array(rows).reshape(3, 4)[:, :3]
        return _Header(axes if code > 0 else None, needed)
    raise UnreadableFileError(
        f"{path} is not a NIfTI file, or is truncated within its header ({len(start)} bytes)"
    )
