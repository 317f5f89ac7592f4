"""Parse the header of a MetaImage file (`.mha`, `.mhd`): lines "name = value", ElementDataFile last."""

import re
from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.io import limits

from .header import ImageHeader, Storage, read_until, real_numbers, three_dimensional, whole_numbers
from .voxel_files import named_voxel_files

_END = re.compile(rb"^[ \t]*ElementDataFile[ \t]*=[ \t]*([^\r\n]*)(?:\r\n|\n|\r|\Z)", re.MULTILINE)
_TYPES = {
    "MET_CHAR": "i1",
    "MET_ASCII_CHAR": "i1",
    "MET_UCHAR": "u1",
    "MET_SHORT": "i2",
    "MET_USHORT": "u2",
    "MET_INT": "i4",
    "MET_UINT": "u4",
    "MET_LONG": "i4",
    "MET_ULONG": "u4",
    "MET_LONG_LONG": "i8",
    "MET_ULONG_LONG": "u8",
    "MET_FLOAT": "f4",
    "MET_DOUBLE": "f8",
}
"""Source: MetaIO, metaTypes.h; MET_LONG has four bytes in files."""
_SYNONYMS = {
    "Position": "Offset",
    "Origin": "Offset",
    "Orientation": "TransformMatrix",
    "Rotation": "TransformMatrix",
    "ElementByteOrderMSB": "BinaryDataByteOrderMSB",
}


def read_metaimage_header(path: Path) -> ImageHeader:
    """Parse the header without reading voxels.

    Raises:
        UnreadableFileError: not MetaImage, a field that is absent or invalid, or voxels stored as text or
            outside its folder.
    """
    data, end = read_until(path, _END)
    if end is None:
        raise UnreadableFileError(
            f"{path} is not a readable image: it has no line ElementDataFile in its first {len(data)} bytes"
        )
    fields = _fields(path, data[: end.start()].decode("utf-8", "replace"))
    if fields.get("ObjectType", "Image") != "Image":
        raise UnreadableFileError(f"{path} holds a MetaIO {fields['ObjectType'][:40]}; needed an Image")
    count = whole_numbers(path, "NDims", fields.get("NDims", ""), 1, 4)[0]
    sizes = whole_numbers(path, "DimSize", fields.get("DimSize", ""), 1, limits.AXIS)
    if len(sizes) != count:
        raise UnreadableFileError(f"{path}: NDims is {count}, DimSize holds {len(sizes)}: copy it again")
    if fields.get("BinaryData", "True").lower() not in ("true", "1"):
        raise UnreadableFileError(f"{path}: its voxels are stored as text; save it as binary data")
    units = fields.get("DistanceUnits", "mm")
    if units.lower() not in ("mm", "?", ""):
        raise UnreadableFileError(f"{path}: its DistanceUnits are '{units[:20]}'; needed mm: save it in mm")
    compressed = _is_true(path, fields, "CompressedData")
    kind, order = (
        fields.get("ElementType", ""),
        ">" if _is_true(path, fields, "BinaryDataByteOrderMSB") else "<",
    )
    if kind not in _TYPES:
        raise UnreadableFileError(
            f"{path}: ElementType is '{kind[:40]}'; needed one of {', '.join(list(_TYPES)[2:])}"
        )
    channels = whole_numbers(
        path, "ElementNumberOfChannels", fields.get("ElementNumberOfChannels", "1"), 1, limits.AXIS
    )
    skip = whole_numbers(path, "HeaderSize", fields.get("HeaderSize", "0"), -1, limits.HEADER_BYTES)[0]
    name = end[1].decode("utf-8", "replace").strip()
    files = named_voxel_files(path, name, lambda: path.read_bytes()[end.end() :].decode("utf-8", "replace"))
    return ImageHeader(
        sizes,
        np.dtype(order + _TYPES[kind]),
        channels[0],
        3 if count == 4 else None,
        *_geometry(path, fields, count),
        Storage(files, end.end(), None if skip < 0 else skip, compressed),
        fields,
    )


def _fields(path: Path, text: str) -> dict[str, str]:
    fields: dict[str, str] = {}
    for line in re.split(r"\r\n|\n|\r", text):
        name, equals, value = line.partition("=")
        if not line.strip():
            continue
        name = _SYNONYMS.get(name.strip(), name.strip())
        if not equals or name in fields:
            wrong = "occurs twice" if equals else "is not 'name = value'"
            raise UnreadableFileError(f"{path}: header line '{line.strip()[:60]}' {wrong}; copy it again")
        fields[name] = value.strip()
    return fields


def _is_true(path: Path, fields: dict[str, str], name: str) -> bool:
    text = fields.get(name, "False").lower()
    if text not in ("true", "false", "1", "0"):
        raise UnreadableFileError(f"{path}: {name} is '{text[:20]}'; needed True or False: copy it again")
    return text in ("true", "1")


def _geometry(path: Path, fields: dict[str, str], count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Parse origin, spacing and direction in space; unused for fewer than three axes."""
    if count < 3:
        return np.zeros(3), np.ones(3), np.eye(3)
    ones, zeros = " ".join(["1"] * count), " ".join(["0"] * count)
    identity = " ".join(f"{v:g}" for v in np.eye(count).ravel())
    spacing = fields.get("ElementSpacing", fields.get("ElementSize", ones))
    rows = real_numbers(path, "TransformMatrix", fields.get("TransformMatrix", identity), count**2)
    offset = real_numbers(path, "Offset", fields.get("Offset", zeros), count)
    direction, origin = three_dimensional(path, rows.reshape(count, count).T, offset)
    return origin, real_numbers(path, "ElementSpacing", spacing, count)[:3], direction
