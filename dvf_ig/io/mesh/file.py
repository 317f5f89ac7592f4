"""Read and write triangle meshes: OBJ, STL, PLY and VTP, in mm, LPS (SPACE=RAS files are converted)."""

import logging
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from dvf_ig.core import BoolArray, Mesh, OutputError, UnreadableFileError
from dvf_ig.io import limits
from dvf_ig.io.reading import read_bytes, reading
from dvf_ig.io.writing.atomic import write_bytes

from .obj import decode_obj, encode_obj
from .ply import decode_ply, encode_ply
from .raw import MeshFormatError, RawMesh
from .stl import decode_stl, encode_stl
from .vtp import decode_vtp, encode_vtp

log = logging.getLogger(__name__)

DECODERS = {".obj": decode_obj, ".stl": decode_stl, ".ply": decode_ply, ".vtp": decode_vtp}
_SPACE = re.compile(r"SPACE\s*=\s*([A-Za-z]+)|(?i:coordinate ?system|space)\s*[=:]\s*(RAS|LPS)\b")
_UNIT = re.compile(
    r"\bunits?\s*[=:]?\s*(mm|cm|m|um|inch(?:es)?|(?:milli|centi|micro)?met(?:er|re)s?)\b", re.IGNORECASE
)
_MILLIMETRES = ("mm", "millimeter", "millimeters", "millimetre", "millimetres")
_TO_LPS = np.array([-1.0, -1.0, 1.0])


def read_mesh(path: Path | str, frame: str = "mr") -> Mesh:
    """Read a triangle mesh; polygons are split into fans, triangle strips into triangles.

    Other content is refused if it may hold a part of the surface; content without area (points, lines) is
    listed in a logged warning.

    Coordinates are LPS unless the file states SPACE=RAS, as 3D Slicer does. STL vertices that coincide
    exactly are merged.

    Args:
        path: `.obj`, `.stl`, `.ply` (ASCII or binary) or `.vtp` (ASCII, inline or appended, zlib or plain).
        frame: name of the mesh's LPS frame.
    Raises:
        UnreadableFileError: absent, another format, damaged, or without triangles.
    """
    path = Path(path)
    raw = decode_mesh(path, read_bytes(path, "a triangle mesh"))
    warn_of_left_out(path, [raw])
    with reading(path, "a triangle mesh"):
        return Mesh(frame, raw.vertices, raw.triangles)


def write_mesh(mesh: Mesh, path: Path | str, flags: Mapping[str, BoolArray] = MappingProxyType({})) -> None:
    """Write a mesh tagged SPACE=LPS; the ending chooses the format.

    OBJ, PLY and VTP keep every digit; STL holds 32-bit floats and no shared vertices.

    Args:
        flags: (t,) of the triangles, by name; VTP alone keeps them.
    Raises:
        OutputError: another ending, or not writable.
    """
    path = Path(path)
    encoders = {".obj": encode_obj, ".stl": encode_stl, ".ply": encode_ply, ".vtp": encode_vtp}
    encode = encoders.get(path.suffix.lower())
    if encode is None:
        raise OutputError(f"cannot write {path}: unknown mesh ending; use one of {', '.join(encoders)}")
    write_bytes(path, encode(RawMesh(mesh.vertices_mm, mesh.triangles, "SPACE=LPS", dict(flags))))


def warn_of_left_out(path: Path, meshes: Iterable[RawMesh]) -> None:
    """Log once the content of the files at `path` that is not part of the surface."""
    for text in dict.fromkeys(", ".join(raw.left_out) for raw in meshes if raw.left_out):
        log.warning("%s: %s have no area and add nothing to the surface", path, text)


def decode_mesh(path: Path, data: bytes) -> RawMesh:
    """Decode a mesh in the format that the ending of `path` names; vertices in LPS.

    Raises:
        UnreadableFileError: unknown ending, damaged or unsupported content, or an unknown or ambiguous SPACE.
    """
    decode = DECODERS.get(path.suffix.lower())
    if decode is None:
        raise UnreadableFileError(f"{path} has no known mesh ending; needed one of {', '.join(DECODERS)}")
    try:
        raw = decode(data)
    except MeshFormatError as exc:
        raise UnreadableFileError(f"{path}: {exc}") from exc
    except (ValueError, LookupError, OverflowError, TypeError, RecursionError, SyntaxError) as exc:
        raise UnreadableFileError(f"{path} is not a readable {path.suffix} mesh: {exc}") from exc
    with reading(path, "a triangle mesh"):
        limits.require_count(
            max(len(raw.vertices), len(raw.triangles)), limits.ELEMENTS, "vertices or triangles"
        )
        limits.require_lengths(raw.vertices, "a vertex")
    spaces = {(one or other).upper() for one, other in _SPACE.findall(raw.note)}
    if not spaces <= {"LPS", "RAS"} or len(spaces) > 1:
        raise UnreadableFileError(
            f"{path} is in the space '{', '.join(sorted(spaces))}'; needed LPS or RAS: export it again"
        )
    if other := [unit for unit in _UNIT.findall(raw.note) if unit.lower() not in _MILLIMETRES]:
        raise UnreadableFileError(f"{path} states that it is in {other[0]}; needed mm: export it again")
    a, b, c = raw.triangles.T
    if collapsed := np.count_nonzero((a == b) | (b == c) | (c == a)):
        raw = replace(raw, left_out=(*raw.left_out, f"{collapsed} triangles that name a vertex twice"))
    if spaces != {"RAS"}:
        return raw
    return replace(raw, vertices=raw.vertices * _TO_LPS, note="SPACE=LPS")
