"""The voxels of a MetaImage or NRRD file, raw or packed; no more is read than its header promises."""

import zlib
from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import AnyArray
from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.io import limits
from dvf_ig.io.provenance import record_file
from dvf_ig.io.reading import refuse_lfs_pointer

from .header import ImageHeader, Storage

_GZIP_OR_ZLIB = 47
_MOST_PACKED = 1032
"""Bytes that one byte of a deflate stream can stand for (RFC 1951: 258 in two bits)."""


def read_voxels(path: Path, header: ImageHeader) -> AnyArray:
    """Values indexed [x, y, z], or [phase, x, y, z] where one of the axes runs over phases.

    Raises:
        UnreadableFileError: more than VOXEL_BYTES, truncated, longer than the header says, or damaged.
    """
    storage, needed = header.storage, header.bytes
    if needed > limits.VOXEL_BYTES:
        raise UnreadableFileError(
            f"{path}: its header states {needed:.3g} bytes; at most {limits.VOXEL_BYTES:.3g} are read"
        )
    for file in storage.files:
        refuse_lfs_pointer(file)
    held = sum(file.stat().st_size for file in storage.files or (path,))
    if needed > held * (_MOST_PACKED if storage.compressed else 1):
        _require_size(path, held, needed)
    flat = (_unpacked if storage.compressed else _raw)(path, storage, needed)
    for file in storage.files:
        record_file(file)
    stored = flat.view(header.dtype).reshape(header.sizes[::-1]).T
    values = stored if header.dtype.isnative else stored.astype(header.dtype.newbyteorder("="))
    return values if header.phase_axis is None else np.moveaxis(values, header.phase_axis, 0)


def _raw(path: Path, storage: Storage, needed: int) -> AnyArray:
    """Raw voxels, of separate files an equal part each."""
    parts = storage.files or (path,)
    if needed % len(parts):
        raise UnreadableFileError(f"{path}: {needed} bytes do not spread over {len(parts)} equal files")
    share, flat = needed // len(parts), np.empty(needed, np.uint8)
    for part, target in zip(parts, flat.reshape(len(parts), share), strict=True):
        size = part.stat().st_size
        skip = storage.skip if storage.files else storage.offset
        begin = max(size - share, 0) if skip is None else skip
        _require_size(part, size - begin, share)
        with part.open("rb") as stream:
            stream.seek(begin)
            got = stream.readinto(target.data)
        _require_size(part, got, share)
    return flat


def _unpacked(path: Path, storage: Storage, needed: int) -> AnyArray:
    """Packed voxels; no more is unpacked than is needed, and a byte."""
    inflater = zlib.decompressobj(_GZIP_OR_ZLIB)
    packed = b"".join(file.read_bytes() for file in storage.files)
    if not storage.files:
        with path.open("rb") as stream:
            stream.seek(storage.offset)
            packed = stream.read()
    try:
        out = inflater.decompress(packed, needed + 1)
    except zlib.error as exc:
        raise UnreadableFileError(f"{path}: its packed voxels are damaged ({exc}); copy it again") from exc
    _require_size(path, len(out), needed)
    if not inflater.eof:
        raise UnreadableFileError(f"{path} is truncated: its packed voxels do not end; copy it again")
    return np.frombuffer(out, np.uint8)


def _require_size(path: Path, got: int, needed: int) -> None:
    if got != needed:
        state = "is truncated" if got < needed else "is longer than its header says"
        raise UnreadableFileError(
            f"{path} {state}: its voxels have {max(got, 0)} bytes, its header needs {needed}; copy it again"
        )
