"""Parse the header of an NRRD file (`.nrrd`, `.nhdr`): lines "field: value" and "key:=value".

Source: teem.sourceforge.net/nrrd/format.html.
"""

import logging
import re
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from dvf_ig.core import FloatArray, UnreadableFileError
from dvf_ig.io import limits

from . import header
from .phase_times import PhaseTimes, uniform_times

log = logging.getLogger(__name__)

_END = re.compile(rb"\r?\n\r?\n")
_MAGIC = re.compile(r"NRRD000[1-6]\s*")
_TYPES = {
    **dict.fromkeys(("signed char", "int8", "int8_t"), "i1"),
    **dict.fromkeys(("uchar", "unsigned char", "uint8", "uint8_t"), "u1"),
    **dict.fromkeys(("short", "short int", "signed short", "signed short int", "int16", "int16_t"), "i2"),
    **dict.fromkeys(("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"), "u2"),
    **dict.fromkeys(("int", "signed int", "int32", "int32_t"), "i4"),
    **dict.fromkeys(("uint", "unsigned int", "uint32", "uint32_t"), "u4"),
    **dict.fromkeys(("longlong", "long long", "long long int", "signed long long", "int64", "int64_t"), "i8"),
    **dict.fromkeys(
        ("ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"), "u8"
    ),
    **dict.fromkeys(("float",), "f4"),
    **dict.fromkeys(("double",), "f8"),
}
_SPACES = {
    **dict.fromkeys(("left-posterior-superior", "lps"), (1.0, 1.0, 1.0)),
    **dict.fromkeys(("right-anterior-superior", "ras"), (-1.0, -1.0, 1.0)),
    **dict.fromkeys(("left-anterior-superior", "las"), (1.0, -1.0, 1.0)),
}
"""Signs that convert a space to LPS. With "-time" or "t" added, its fourth axis is time."""
_DOMAIN_KINDS = ("domain", "space", "time", "???", "none")
_MILLIMETRES = ("", "mm", "millimeter", "millimeters", "millimetre", "millimetres")
_FIELDS = re.compile(
    "content|number|type|block size|dimension|space( (dimension|units|origin|directions))?|sizes|spacings|"
    "thicknesses|axis (mins|maxs)|centers|kinds|labels|units|(old )?(min|max)|endian|encoding|"
    "(line|byte) skip|sample units|measurement frame|data file"
)
"""Every field of the format; keys ("name:=value") may have any name."""
_JOINED = {
    "datafile": "data file",
    "lineskip": "line skip",
    "byteskip": "byte skip",
    "blocksize": "block size",
    "axismins": "axis mins",
    "axismaxs": "axis maxs",
    "oldmin": "old min",
    "oldmax": "old max",
    "sampleunits": "sample units",
    "centerings": "centers",
}
"""Other spellings of fields."""
_TIME_TAGS = ("", "TriggerTime", "AcquisitionTime", "ContentTime", "SeriesTime", "TemporalPositionIdentifier")
"""DICOM attributes that number or time the frames of a MultiVolume."""
_VECTOR = re.compile(r"none|\(([^()]*)\)")


def read_nrrd_header(path: Path) -> header.ImageHeader:
    """Parse the header without reading voxels.

    Raises:
        UnreadableFileError: not NRRD, a field that is absent or invalid, an unknown space or unit, or voxels
            in an unsupported encoding or outside its folder.
    """
    data, end = header.read_until(path, _END)
    if len(data) > limits.HEADER_BYTES and end is None:
        raise UnreadableFileError(f"{path}: its header does not end within {len(data)} bytes; copy it again")
    text = data[: len(data) if end is None else end.start()].decode("utf-8", "replace")
    fields = _fields(path, text)
    sizes = header.whole_numbers(path, "sizes", fields.get("sizes", ""), 1, limits.AXIS)
    if header.whole_numbers(path, "dimension", fields.get("dimension", ""), 1, 16)[0] != len(sizes):
        raise UnreadableFileError(
            f"{path}: dimension is {fields['dimension']}, sizes holds {len(sizes)}: copy it again"
        )
    kinds = fields.get("kinds", "").lower().split() or ["domain"] * len(sizes)
    if len(kinds) != len(sizes):
        raise UnreadableFileError(f"{path}: {len(kinds)} kinds of {len(sizes)} axes: copy it again")
    ranges = [a for a, kind in enumerate(kinds) if kind not in _DOMAIN_KINDS]
    if len(ranges) > 1:
        raise UnreadableFileError(
            f"{path}: the kinds of its axes are {' '.join(kinds)[:60]}; needed an image"
        )
    listed = len(sizes) == 4 and [kinds[a] for a in ranges] == ["list"]
    dropped = [] if listed else ranges
    if dropped not in ([], [0]):
        raise UnreadableFileError(
            f"{path}: the values of a voxel are not stored next to each other; save it again"
        )
    for name in ("old min", "old max"):
        if fields.get(name, "nan").lower() != "nan":
            raise UnreadableFileError(
                f"{path}: {name} is {fields[name][:20]}, so its values are quantised; save its real values"
            )
    space_axes, phase = _axes(path, fields, kinds, listed=listed, dropped=dropped)
    stored = [a for a in range(len(sizes)) if a not in dropped]
    return header.ImageHeader(
        tuple(sizes[a] for a in stored),
        _dtype(path, fields),
        sizes[dropped[0]] if dropped else 1,
        None if phase is None else stored.index(phase),
        *_geometry(path, fields, space_axes, phase),
        _storage(path, fields, text, len(data) if end is None else end.end()),
        fields,
        None if phase is None else _times(path, fields, phase, sizes[phase]),
    )


def _times(path: Path, fields: dict[str, str], axis: int, count: int) -> PhaseTimes | None:
    """Return the times of the volumes along a stored axis; None if the header states none.

    Source: 3D Slicer's volume sequences (docs, "Volume sequence file format") and its MultiVolumeExplorer.

    Raises:
        UnreadableFileError: times that are not numbers, of another number of volumes, or stated twice.
    """
    label, unit = (_of_axis(fields, name, axis) for name in ("labels", "units"))
    unit = unit or fields.get(f"axis {axis} index unit", "") or (label if "%" in label else "")
    stated, name = [], f"axis {axis} index values"
    if name in fields and fields.get(f"axis {axis} index type") != "text":
        stated.append(PhaseTimes(header.real_numbers(path, name, unquote(fields[name]), count), unit, name))
    elif name in fields:
        stated += _numbered(path, name, [unquote(word) for word in fields[name].split()], unit)
    name, tag = "MultiVolume.FrameLabels", fields.get("MultiVolume.FrameIdentifyingDICOMTagName", "")
    if name in fields and tag in _TIME_TAGS:
        own = fields.get("MultiVolume.FrameIdentifyingDICOMTagUnits", "")
        stated.append(
            PhaseTimes(header.real_numbers(path, name, fields[name].replace(",", " "), count), own, name)
        )
    if len(stated) == 2 and not np.array_equal(stated[0].order(path), stated[1].order(path)):
        raise UnreadableFileError(
            f"{path}: {stated[0].field} and {stated[1].field} put its volumes in different orders; delete one"
        )
    if stated:
        return stated[-1] if len(stated) == 2 and not stated[0].unit else stated[0]
    words, vectors = fields.get("spacings", "").split(), _VECTOR.findall(fields.get("space directions", ""))
    along = vectors[axis].split(",") if axis < len(vectors) else []
    step = along[-1] if len(along) == 4 else words[axis] if axis < len(words) else "nan"
    try:
        return uniform_times(
            float(step), count, unit or _of_axis(fields, "space units", 3), "the spacing of its time axis"
        )
    except ValueError:
        return None  # the geometry refuses what is no number


def _numbered(path: Path, name: str, labels: list[str], unit: str) -> list[PhaseTimes]:
    """Return the numbers in labels such as "frame 40" or "40 %", if each holds one."""
    found = [re.findall(r"\d+(?:\.\d+)?", label) for label in labels]
    if not labels or any(len(numbers) != 1 for numbers in found):
        log.warning("%s: %s are texts without one number each: they do not order its volumes", path, name)
        return []
    percent = all("%" in label for label in labels)
    return [PhaseTimes(np.array(found, dtype=np.float64).ravel(), "%" if percent else unit, name)]


def _of_axis(fields: dict[str, str], name: str, axis: int) -> str:
    quoted = re.findall(r'"([^"]*)"', fields.get(name, ""))
    return quoted[axis].strip() if axis < len(quoted) else ""


def _fields(path: Path, text: str) -> dict[str, str]:
    """Parse fields under their lower-case names, and keys under their own names."""
    lines = re.split(r"\r\n|\n|\r", text)
    if _MAGIC.fullmatch(lines[0]) is None:
        raise UnreadableFileError(f"{path} is not a readable image: it does not begin with NRRD000X")
    fields: dict[str, str] = {}
    for line in lines[1:]:
        if not line.strip() or line.startswith("#"):
            continue
        match = re.match(r"([^:]+?):(=?)[ \t]*(.*)", line, re.DOTALL)
        name = "" if match is None else match[1] if match[2] else _plain_name(match[1])
        if match is None or name in fields:
            if match is None and "data file" in fields:
                continue  # names of a LIST
            wrong = "is not 'field: value'" if match is None else "occurs twice"
            raise UnreadableFileError(f"{path}: header line '{line.strip()[:60]}' {wrong}; copy it again")
        if not match[2] and not _FIELDS.fullmatch(name):
            raise UnreadableFileError(
                f"{path}: its header has a field '{name[:40]}', which NRRD does not define; correct its name"
            )
        fields[name] = match[3].strip()
    return fields


def _plain_name(name: str) -> str:
    """Normalise a field name: NRRD allows some names without their blank, such as "datafile"."""
    plain = name.strip().lower()
    return _JOINED.get(plain, plain)


def _dtype(path: Path, fields: dict[str, str]) -> np.dtype[np.generic]:
    kind = fields.get("type", "").lower()
    if kind not in _TYPES:
        raise UnreadableFileError(
            f"{path}: type is '{kind[:40]}'; needed a number of 1, 2, 4 or 8 bytes, such as uint8 or float"
        )
    endian = fields.get("endian", "" if _TYPES[kind][1] != "1" else "little").lower()
    if endian not in ("little", "big"):
        raise UnreadableFileError(f"{path}: endian is '{endian[:20]}'; needed little or big: copy it again")
    return np.dtype(("<" if endian == "little" else ">") + _TYPES[kind])


def _storage(path: Path, fields: dict[str, str], text: str, end: int) -> header.Storage:
    encoding = fields.get("encoding", "").lower()
    if encoding not in ("raw", "gzip", "gz"):
        raise UnreadableFileError(f"{path}: encoding is '{encoding[:20]}'; save it as raw or gzip")
    if fields.get("line skip", "0") != "0":
        raise UnreadableFileError(
            f"{path}: its voxels follow another header (line skip); save it as NRRD again"
        )
    skip = header.whole_numbers(path, "byte skip", fields.get("byte skip", "0"), -1, limits.HEADER_BYTES)[0]
    compressed = encoding != "raw"
    if compressed and skip:
        raise UnreadableFileError(
            f"{path}: byte skip applies to raw voxels, but these are {encoding}; save it again"
        )
    names = re.split(r"(?im)^data ?file:.*$", text)[-1]
    files = header.named_voxel_files(path, fields.get("data file", "LOCAL"), lambda: names)
    return header.Storage(files, end, None if skip < 0 else skip, compressed)


def _axes(
    path: Path, fields: dict[str, str], kinds: list[str], *, listed: bool, dropped: list[int]
) -> tuple[list[int], int | None]:
    """Find the three stored axes in space, and the one that runs over phases."""
    axes = [a for a in range(len(kinds)) if a not in dropped]
    if len(axes) > 4:
        raise UnreadableFileError(f"{path} has {len(axes)} axes; needed 3, or 4 with phases")
    if len(axes) < 4:
        return axes if len(axes) == 3 else [], None
    vectors = [match[1] for match in _VECTOR.finditer(fields.get("space directions", ""))]
    none = [a for a, vector in enumerate(vectors) if vector is None]
    marked = [a for a in axes if kinds[a] == ("list" if listed else "time")] or none or [axes[-1]]
    return [a for a in axes if a != marked[0]], marked[0]


def _geometry(
    path: Path, fields: dict[str, str], axes: list[int], phase: int | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Parse origin, spacing and direction in LPS, mm."""
    if not axes:
        return np.zeros(3), np.ones(3), np.eye(3)
    if "space" not in fields and "space dimension" not in fields:
        return _without_space(path, fields, axes)
    by_itk = fields.get("space dimension") == "4"  # so ITK writes LPS and time
    space = fields.get("space", "lpst" if by_itk else "of unknown axes").lower()
    timed = space.endswith("-time") or (len(space) == 4 and space.endswith("t"))
    name = space.removesuffix("-time" if space.endswith("-time") else "t") if timed else space
    if name not in _SPACES:
        raise UnreadableFileError(
            f"{path}: its space is '{space[:40]}'; needed left-posterior-superior or right-anterior-superior"
        )
    _require_millimetres(path, "space units", fields, [0, 1, 2])
    for other in ("spacings", "axis mins", "axis maxs"):
        words = fields.get(other, "").lower().split()
        if any(a < len(words) and words[a] != "nan" for a in axes):
            raise UnreadableFileError(
                f"{path} states its axes twice (delete one), by space directions "
                f"'{fields.get('space directions', '')[:60]}' and by {other} '{fields[other][:30]}'"
            )
    count = 4 if timed else 3
    matrix = np.eye(count)
    matrix[:, :3] = np.column_stack([_direction(path, fields, a, count) for a in axes])
    if timed and phase is not None:
        matrix[:, 3] = _direction(path, fields, phase, count)
    turn = np.array(_SPACES[name])
    matrix, origin = header.three_dimensional(path, matrix, _origin(path, fields, count))
    return origin * turn, *header.sides_and_directions(path, matrix * turn[:, None])


def _direction(path: Path, fields: dict[str, str], axis: int, count: int) -> FloatArray:
    """Parse one step along a stored axis, (count,), mm."""
    text = fields.get("space directions", "")
    vectors = [match[1] for match in _VECTOR.finditer(text)]
    vector = vectors[axis] if axis < len(vectors) and not _VECTOR.sub("", text).strip() else None
    return header.real_numbers(
        path, "space directions", "none" if vector is None else vector.replace(",", " "), count
    )


def _origin(path: Path, fields: dict[str, str], count: int) -> FloatArray:
    if "space origin" not in fields:
        log.warning("%s states no space origin: 0 is assumed", path)
    text = fields.get("space origin", f"({','.join(['0'] * count)})")
    match = _VECTOR.fullmatch(text)
    inside = text if match is None or match[1] is None else match[1].replace(",", " ")
    return header.real_numbers(path, "space origin", inside, count)


def _without_space(
    path: Path, fields: dict[str, str], axes: list[int]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Parse a file that states only the spacing; its axes are assumed to be LPS."""
    _require_millimetres(path, "units", fields, axes)
    words = fields.get("spacings", "").split()
    chosen = " ".join(words[a] for a in axes if a < len(words))
    if "axis maxs" in fields:
        raise UnreadableFileError(
            f"{path} states axis maxs; save it with space directions and a space origin"
        )
    begins = fields.get("axis mins", "").lower().split()
    first = " ".join("0" if a >= len(begins) or begins[a] == "nan" else begins[a] for a in axes)
    log.warning("%s does not state the direction of its axes: left, posterior, superior are assumed", path)
    spacing = header.real_numbers(path, "spacings", chosen, 3)
    origin = header.real_numbers(path, "axis mins", first, 3)
    return origin, *header.sides_and_directions(path, np.diag(spacing))


def _require_millimetres(path: Path, name: str, fields: dict[str, str], axes: list[int]) -> None:
    units = re.findall(r'"([^"]*)"', fields.get(name, ""))
    other = [units[a] for a in axes if a < len(units) and units[a].strip().lower() not in _MILLIMETRES]
    if other:
        raise UnreadableFileError(f"{path}: its {name} are '{other[0][:20]}'; needed mm: save it in mm")
