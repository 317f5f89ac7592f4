"""Read and write STL, ASCII and binary: triangles whose exactly coinciding vertices are merged."""

import re

import numpy as np

from dvf_ig.core.arrays import FloatArray

from .raw import MeshFormatError, RawMesh, left_after, text_lines

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER_BYTES = 80
_ASCII = re.compile(rb"\s*solid[^\r\n]*[\r\n]\s*(facet|endsolid)", re.IGNORECASE)
_FOLLOWS = {
    "solid": ("facet", "endsolid"),
    "facet": ("outer",),
    "outer": ("vertex",),
    "vertex": ("vertex",),
    "endloop": ("endfacet",),
    "endfacet": ("facet", "endsolid"),
    "endsolid": ("solid",),
}
"""Keywords of ASCII lines with those that may follow; after the third vertex, endloop."""


def decode_stl(data: bytes) -> RawMesh:
    """Decode an STL file: all solids of an ASCII file, the one of a binary file.

    A binary file may also begin with "solid"; its size or a zero byte identifies it.
    """
    if len(data) >= _HEADER_BYTES + 4:
        count = int.from_bytes(data[_HEADER_BYTES : _HEADER_BYTES + 4], "little")
        end = _HEADER_BYTES + 4 + count * _RECORD.itemsize
        named_solid = data.lstrip()[:5].lower() == b"solid"
        if len(data) == end or not named_solid or (b"\0" in data and not _ASCII.match(data)):
            if len(data) < end:
                raise MeshFormatError(f"the file has {len(data)} bytes, its {count} triangles need {end}")
            records = np.frombuffer(data, _RECORD, count, _HEADER_BYTES + 4)
            note = data[:_HEADER_BYTES].decode("latin-1")
            rest = left_after(memoryview(data)[end:], f"{count} triangles", _RECORD.itemsize)
            return _welded(records["corners"], note, rest)
    return _decode_ascii(data)


def _decode_ascii(data: bytes) -> RawMesh:
    """Decode ASCII STL; every line must be valid and in order, keywords in any case."""
    lines = text_lines(data.decode("latin-1"))
    rows = [(number, words) for number, line in enumerate(lines, 1) if (words := line.split())]
    if not rows or rows[0][1][0].lower() != "solid":
        raise MeshFormatError("neither a binary nor an ASCII STL file")
    notes: list[str] = []
    corners: list[list[str]] = []
    expected: tuple[str, ...] = ("solid",)
    for number, words in rows:
        keyword = words[0].lower()
        if keyword not in expected:
            raise MeshFormatError(
                f"line {number} is {' '.join(words)[:40]!r}; needed {' or '.join(expected)}: a facet has "
                "three vertices; export the mesh again"
            )
        if keyword == "solid":
            notes.append(lines[number - 1])
        elif keyword == "vertex":
            if len(words) != 4:
                raise MeshFormatError(f"line {number} is a vertex of {len(words) - 1} numbers; needed 3")
            corners.append(words[1:])
        expected = ("endloop",) if keyword == "vertex" and len(corners) % 3 == 0 else _FOLLOWS[keyword]
    if keyword != "endsolid":
        raise MeshFormatError(
            f"{len(corners)} vertices and no proper end; the file is truncated: copy it again"
        )
    return _welded(np.array(corners, dtype=np.float64).reshape(-1, 3, 3), "\n".join(notes))


def _welded(corners: FloatArray, note: str, left_out: tuple[str, ...] = ()) -> RawMesh:
    """Merge equal corners, numbered by first appearance so that corresponding files keep equal numbering."""
    if not np.isfinite(corners).all():
        raise MeshFormatError("a corner is not finite; export it again")
    points = corners.reshape(-1, 3).astype(np.float64)
    _, first, inverse = np.unique(points, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return RawMesh(points[first[order]], rank[inverse.reshape(-1)].reshape(-1, 3), note, left_out=left_out)


def encode_stl(mesh: RawMesh) -> bytes:
    """Encode binary STL with 32-bit floats and the SPACE tag in its header."""
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    records = np.zeros(len(corners), _RECORD)
    records["normal"] = normals / np.where(length > 0, length, 1.0)
    records["corners"] = corners
    header = f"dvf_ig {mesh.note}".encode("ascii").ljust(_HEADER_BYTES, b" ")
    return header + len(corners).to_bytes(4, "little") + records.tobytes()
