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
_BLOCK = 1 << 22
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
    flat = np.empty(needed, np.uint8)
    (_unpack if storage.compressed else _copy)(path, storage, flat)
    for file in storage.files:
        record_file(file)
    stored = flat.view(header.dtype).reshape(header.sizes[::-1]).T
    values = stored if header.dtype.isnative else stored.astype(header.dtype.newbyteorder("="))
    return values if header.phase_axis is None else np.moveaxis(values, header.phase_axis, 0)


def _copy(path: Path, storage: Storage, flat: AnyArray) -> None:
    """Raw voxels, of separate files an equal part each."""
    parts = [path] if not storage.files else list(storage.files)
    if flat.size % len(parts):
        raise UnreadableFileError(f"{path}: {flat.size} bytes do not spread over {len(parts)} equal files")
    share = flat.size // len(parts)
    for part, target in zip(parts, flat.reshape(len(parts), share), strict=True):
        size = part.stat().st_size
        skip = storage.skip if storage.files else storage.offset
        begin = max(size - share, 0) if skip is None else skip
        _require_size(part, size - begin, share)
        with part.open("rb") as stream:
            stream.seek(begin)
            got = stream.readinto(target.data)
        _require_size(part, got, share)


def _unpack(path: Path, storage: Storage, flat: AnyArray) -> None:
    parts = [path] if not storage.files else list(storage.files)
    inflater, filled = zlib.decompressobj(_GZIP_OR_ZLIB), 0
    try:
        for part in parts:
            with part.open("rb") as stream:
                stream.seek(0 if storage.files else storage.offset)
                while not inflater.eof and (block := stream.read(_BLOCK)):
                    filled = _inflate(path, inflater, block, flat, filled)
    except zlib.error as exc:
        raise UnreadableFileError(f"{path}: its packed voxels are damaged ({exc}); copy it again") from exc
    _require_size(path, filled, flat.size)
    if not inflater.eof:
        raise UnreadableFileError(f"{path} is truncated: its packed voxels do not end; copy it again")


def _inflate(path: Path, inflater: "zlib._Decompress", block: bytes, flat: AnyArray, filled: int) -> int:
    """Unpack a block into the array; how much of it is filled then."""
    while block:
        out = inflater.decompress(block, _BLOCK)
        if filled + len(out) > flat.size:
            _require_size(path, filled + len(out), flat.size)
        flat[filled : filled + len(out)] = np.frombuffer(out, np.uint8)
        filled += len(out)
        block = inflater.unconsumed_tail
    return filled


def _require_size(path: Path, got: int, needed: int) -> None:
    if got != needed:
        state = "is truncated" if got < needed else "is longer than its header says"
        raise UnreadableFileError(
            f"{path} {state}: its voxels have {max(got, 0)} bytes, its header needs {needed}; copy it again"
        )
