"""Read the voxels of a MetaImage or NRRD file, raw or compressed, and no more than its header states."""

import logging
from pathlib import Path

import numpy as np

from dvf_ig.core import AnyArray, UnreadableFileError
from dvf_ig.io import limits
from dvf_ig.io.inflate import MOST_PACKED, inflated, require_size
from dvf_ig.io.provenance import record_file
from dvf_ig.io.reading import refuse_lfs_pointer

from .header import ImageHeader, Storage

log = logging.getLogger(__name__)

_AT_ONCE = 256
"""Bytes copied per step: four cache lines of a processor."""
_MANY_SLICES = 64


def read_voxels(path: Path, header: ImageHeader) -> AnyArray:
    """Read values indexed [x, y, z], or [phase, x, y, z] if one of the axes runs over phases.

    Raises:
        UnreadableFileError: more than VOXEL_BYTES, truncated, longer than the header says, or damaged.
    """
    storage, needed = header.storage, header.bytes
    if needed > limits.VOXEL_BYTES:
        raise UnreadableFileError(
            f"{path}: its header states {needed:.3g} bytes; at most {limits.VOXEL_BYTES:.3g} can be read"
        )
    for file in storage.files:
        refuse_lfs_pointer(file)
    stored_bytes = sum(file.stat().st_size for file in storage.files or (path,))
    if needed > stored_bytes * (MOST_PACKED if storage.compressed else 1):
        require_size(path, stored_bytes, needed)
    stated = header.fields.get("CompressedDataSize", "")
    flat = _unpacked(path, storage, needed, stated) if storage.compressed else _raw(path, storage, needed)
    for file in storage.files:
        record_file(file)
    stored = flat.view(header.dtype).reshape(header.sizes[::-1]).T
    values = stored if header.dtype.isnative else stored.astype(header.dtype.newbyteorder("="))
    return values if header.phase_axis is None else np.moveaxis(values, header.phase_axis, 0)


def _raw(path: Path, storage: Storage, needed: int) -> AnyArray:
    """Read raw voxels; separate files hold an equal part each."""
    parts = storage.files or (path,)
    if needed % len(parts):
        raise UnreadableFileError(
            f"{path}: {needed} bytes cannot be split over {len(parts)} equal files; save it again"
        )
    share, flat = needed // len(parts), np.empty(needed, np.uint8)
    for part, target in zip(parts, flat.reshape(len(parts), share), strict=True):
        size = part.stat().st_size
        first = 0 if storage.files else storage.offset
        begin = max(size - share, first) if storage.skip is None else first + storage.skip
        if storage.skip is None and begin > first:
            log.warning("%s: %d bytes before its voxels are skipped, as its header asks", part, begin - first)
        require_size(part, size - begin, share)
        with part.open("rb") as stream:
            stream.seek(begin)
            got = stream.readinto(target.data)
        require_size(part, got, share)
    return flat


def _unpacked(path: Path, storage: Storage, needed: int, stated: str) -> AnyArray:
    packed = b"".join(file.read_bytes() for file in storage.files)
    if not storage.files:
        with path.open("rb") as stream:
            stream.seek(storage.offset)
            packed = stream.read()
    if stated and stated != str(len(packed)):
        raise UnreadableFileError(
            f"{path}: CompressedDataSize is {stated[:20]}, but {len(packed)} bytes follow; copy it again"
        )
    return inflated(path, packed, needed)


def in_c_order(values: AnyArray) -> AnyArray:
    """Copy (…, x, y, z) values in any memory order so that the last axis is contiguous.

    Files hold x fastest, so neighbours along z are a slice apart: with many slices, voxels are copied in
    short runs along x that fill whole cache lines.
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
