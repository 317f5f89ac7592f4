"""Parse the header of a MetaImage file (`.mha`, `.mhd`): lines "name = value", ElementDataFile last."""

import difflib
import logging
import re
from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, UnreadableFileError
from dvf_ig.io import limits

from .header import (
    ImageHeader,
    Storage,
    named_voxel_files,
    read_until,
    real_numbers,
    three_dimensional,
    whole_numbers,
)
from .phase_times import PhaseTimes, uniform_times

log = logging.getLogger(__name__)

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

_NAMES = (
    *("ObjectType", "NDims", "BinaryData", "BinaryDataByteOrderMSB", "CompressedData", "CompressedDataSize"),
    *(
        "TransformMatrix",
        "Offset",
        "CenterOfRotation",
        "AnatomicalOrientation",
        "ElementSpacing",
        "ElementSize",
    ),
    *("DimSize", "ElementType", "ElementNumberOfChannels", "HeaderSize", "DistanceUnits", "ElementDataFile"),
    *("ObjectSubType", "ElementMin", "ElementMax", "ElementNBits", "ID", "ParentID", "TransformType"),
)
"""MetaIO's fields; another name must not look like one of them."""
_LONGEST, _MOST_COMPARED = 32, 256
"""Length of the names that are compared with them, and number of fields after which none is."""
_NEUTRAL = {
    "CenterOfRotation": ("0", "-0", "0.0"),
    "ElementToIntensityFunctionSlope": ("1", "1.0"),
    "ElementToIntensityFunctionOffset": ("0", "0.0"),
}
"""Values of fields that change nothing."""
_FROM = {
    "R": (1.0, 0.0, 0.0),
    "L": (-1.0, 0.0, 0.0),
    "A": (0.0, 1.0, 0.0),
    "P": (0.0, -1.0, 0.0),
    "I": (0.0, 0.0, 1.0),
    "S": (0.0, 0.0, -1.0),
}
"""LPS direction of an axis that comes from right, left, anterior, posterior, inferior or superior."""


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
    if skip and (compressed or name.upper() == "LOCAL"):
        raise UnreadableFileError(
            f"{path}: HeaderSize is {skip}, which applies to raw voxels in a separate file; delete that line"
        )
    geometry = _geometry(path, fields, count)
    _require_no_other_statement(path, fields, count, geometry[2])
    files = named_voxel_files(path, name, lambda: path.read_bytes()[end.end() :].decode("utf-8", "replace"))
    return ImageHeader(
        sizes,
        np.dtype(order + _TYPES[kind]),
        channels[0],
        3 if count == 4 else None,
        *geometry,
        Storage(files, end.end(), None if skip < 0 else skip, compressed),
        fields,
        _times(path, fields, sizes) if count == 4 else None,
    )


def _times(path: Path, fields: dict[str, str], sizes: tuple[int, ...]) -> PhaseTimes | None:
    """Return PLUS's time stamps of the volumes, else equal steps along the fourth axis, without a unit."""
    stamps = [fields.get(f"Seq_Frame{i:04d}_Timestamp") for i in range(sizes[3])]
    stated = [stamp for stamp in stamps if stamp is not None]
    if stated:
        return PhaseTimes(real_numbers(path, "Timestamp", " ".join(stated), sizes[3]), "s", "Timestamp")
    step = real_numbers(path, "ElementSpacing", _spacing(fields), 4)[3]
    return uniform_times(float(step), sizes[3], "", "ElementSpacing of its fourth axis")


def _require_no_other_statement(
    path: Path, fields: dict[str, str], count: int, direction: FloatArray
) -> None:
    """Refuse fields that contradict others, or would change voxels in a way that is not read.

    Source: MetaIO, metaObject.h and metaImage.h; an orientation names where each axis comes from.
    """
    if fields.get("ElementSize", "") not in ("", fields.get("ElementSpacing", fields.get("ElementSize"))):
        spacing, size = (real_numbers(path, n, fields[n], count) for n in ("ElementSpacing", "ElementSize"))
        if not np.allclose(spacing, size, rtol=1e-3):
            raise UnreadableFileError(
                f"{path}: its ElementSpacing is '{fields['ElementSpacing'][:40]}', its ElementSize "
                f"'{fields['ElementSize'][:40]}'; delete the one that is not the distance of voxels"
            )
    for name, neutral in _NEUTRAL.items():
        words = fields.get(name, "").split()
        if any(word not in neutral for word in words):
            raise UnreadableFileError(
                f"{path}: {name} is '{fields[name][:40]}', which is not applied; save it without"
            )
    letters = fields.get("AnatomicalOrientation", "?").upper()
    if count < 3 or set(letters) <= set("? "):
        return
    toward = np.array([_FROM.get(letter, (0.0, 0.0, 0.0)) for letter in letters[:3].ljust(3)])
    if (np.einsum("ac,ca->a", toward, direction) <= 0).any():
        raise UnreadableFileError(
            f"{path}: its AnatomicalOrientation is '{letters[:10]}', but its TransformMatrix "
            f"'{fields.get('TransformMatrix', 'of no turn')[:80]}' states another; correct one"
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
        if name in _NAMES or len(name) > _LONGEST or len(fields) > _MOST_COMPARED:
            continue
        if close := difflib.get_close_matches(name, _NAMES, 1, 0.85):
            raise UnreadableFileError(
                f"{path}: its field {name[:40]} is not known; write {close[0]}, or rename it"
            )
    return fields


def _spacing(fields: dict[str, str]) -> str:
    return fields.get("ElementSpacing", fields.get("ElementSize", ""))


def _is_true(path: Path, fields: dict[str, str], name: str) -> bool:
    text = fields.get(name, "False").lower()
    if text not in ("true", "false", "1", "0"):
        raise UnreadableFileError(f"{path}: {name} is '{text[:20]}'; needed True or False: copy it again")
    return text in ("true", "1")


def _geometry(path: Path, fields: dict[str, str], count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Parse origin, spacing and direction in space; unused for fewer than three axes."""
    if count < 3:
        return np.zeros(3), np.ones(3), np.eye(3)
    zeros = " ".join(["0"] * count)
    if absent := [name for name in ("TransformMatrix", "Offset") if name not in fields]:
        log.warning(
            "%s states no %s: axes of LPS and an origin of 0 are assumed", path, " and no ".join(absent)
        )
    identity = " ".join(f"{v:g}" for v in np.eye(count).ravel())
    rows = real_numbers(path, "TransformMatrix", fields.get("TransformMatrix", identity), count**2)
    offset = real_numbers(path, "Offset", fields.get("Offset", zeros), count)
    direction, origin = three_dimensional(path, rows.reshape(count, count).T, offset)
    return origin, real_numbers(path, "ElementSpacing", _spacing(fields), count)[:3], direction
