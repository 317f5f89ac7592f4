"""The voxels of a MetaImage or NRRD file, raw or packed; no more is read than its header promises."""

from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import AnyArray
from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.io import limits
from dvf_ig.io.inflate import MOST_PACKED, inflated, require_size
from dvf_ig.io.provenance import record_file
from dvf_ig.io.reading import refuse_lfs_pointer

from .header import ImageHeader, Storage

_AT_ONCE = 256
"""Bytes: four lines of a processor's cache."""
_MANY_SLICES = 64


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
    if needed > held * (MOST_PACKED if storage.compressed else 1):
        require_size(path, held, needed)
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
        require_size(part, size - begin, share)
        with part.open("rb") as stream:
            stream.seek(begin)
            got = stream.readinto(target.data)
        require_size(part, got, share)
    return flat


def _unpacked(path: Path, storage: Storage, needed: int) -> AnyArray:
    packed = b"".join(file.read_bytes() for file in storage.files)
    if not storage.files:
        with path.open("rb") as stream:
            stream.seek(storage.offset)
            packed = stream.read()
    return inflated(path, packed, needed)


def in_c_order(values: AnyArray) -> AnyArray:
    """A copy whose last axis is contiguous, of (…, x, y, z) in any order.

    Files hold x fastest, so that neighbours along z are a slice apart: where the slices are many, voxels are
    copied so many along x at a time that what memory gives at once is used at once.
    """
    if values.shape[-1] < _MANY_SLICES:
        return np.array(values, order="C")
    out = np.empty(values.shape, values.dtype)
    step = _AT_ONCE // values.itemsize
    for part, target in zip(_volumes(values), _volumes(out), strict=True):
        for x in range(0, part.shape[0], step):
            for y in range(part.shape[1]):
                target[x : x + step, y] = part[x : x + step, y]
    return out


def _volumes(values: AnyArray) -> list[AnyArray]:
    return [values] if values.ndim == 3 else list(values)
