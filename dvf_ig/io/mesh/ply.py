"""Read and write PLY, ASCII and binary of either byte order: elements `vertex` (x, y, z) and `face`."""

import re
from dataclasses import dataclass, field

import numpy as np

from dvf_ig.core.arrays import AnyArray

from .raw import MeshFormatError, RawMesh, fan_triangles, left_after, text_lines, whole_indices

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


_END_HEADER = re.compile(rb"[\r\n]end_header[ \t]*(\r\n|\n|\r)")
_INDEX_LISTS = ("vertex_indices", "vertex_index")
_WITHOUT_SURFACE = ("edge", "camera", "material")
_SMALLEST_FACE = 4
"""Bytes of a triangle with a count and indices of one byte each."""
_Tables = dict[str, dict[str, list[AnyArray] | AnyArray]]
"""Columns by element and property; a list property has one array per row."""


@dataclass(slots=True)
class _Element:
    """One element of the header; `properties` holds name, type, and the count type of a list (or None)."""

    name: str
    count: int
    properties: list[tuple[str, str, str | None]] = field(default_factory=list)


def decode_ply(data: bytes) -> RawMesh:
    """Decode a PLY file: all of its faces; other elements are listed or refused."""
    end = _END_HEADER.search(data)
    if not data.startswith(b"ply") or end is None:
        raise MeshFormatError("not a PLY file (no 'ply' … 'end_header')")
    form, elements, note = _header(data[: end.start()].decode("ascii", "replace"))
    body = memoryview(data)[end.end() :]
    if form == "ascii":
        tables, end_at = _ascii_tables(bytes(body).decode("ascii", "replace"), elements), len(body)
    else:
        tables, end_at = _binary_tables(body, elements, "<" if "little" in form else ">")
    rest = left_after(body[end_at:], "elements", _SMALLEST_FACE)
    left_out = _require_known(elements)
    vertex, face = tables["vertex"], tables["face"]
    lists = face[_index_list(elements)]
    counts = np.array([len(polygon) for polygon in lists], dtype=np.int64)
    corners = np.concatenate(lists) if len(lists) else np.zeros(0, np.int64)
    points = np.stack([np.asarray(vertex[axis], dtype=np.float64) for axis in "xyz"], axis=1)
    triangles, _ = fan_triangles(whole_indices(corners, len(points), "face"), counts)
    return RawMesh(points, triangles, note, left_out=left_out + rest)


def encode_ply(mesh: RawMesh) -> bytes:
    """Encode binary little-endian PLY with 64-bit coordinates and the SPACE tag in a comment."""
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment {mesh.note}\n"
        f"element vertex {len(mesh.vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(mesh.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(len(mesh.triangles), np.dtype([("n", "u1"), ("corners", "<i4", 3)]))
    faces["n"], faces["corners"] = 3, mesh.triangles
    return header.encode("ascii") + mesh.vertices.astype("<f8").tobytes() + faces.tobytes()


def _header(text: str) -> tuple[str, list[_Element], str]:
    form, elements, notes = "", list[_Element](), list[str]()
    for line in text_lines(text)[1:]:
        words = line.split()
        if words[:1] == ["format"]:
            form = words[1]
        elif words[:1] in (["comment"], ["obj_info"]):
            notes.append(line)
        elif words[:1] == ["element"]:
            elements.append(_Element(words[1], int(words[2])))
        elif words[:2] == ["property", "list"]:
            elements[-1].properties.append((words[4], _type(words[3]), _type(words[2])))
        elif words[:1] == ["property"]:
            elements[-1].properties.append((words[2], _type(words[1]), None))
        elif words:
            raise MeshFormatError(f"its header line {line.strip()[:40]!r} is not PLY; export the mesh again")
    if form not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise MeshFormatError(
            f"PLY format '{form}' is unknown; needed ascii, binary_little_endian or binary_big_endian"
        )
    return form, elements, "\n".join(notes)


def _type(name: str) -> str:
    if name not in _TYPES:
        raise MeshFormatError(f"a property has the type '{name[:20]}'; needed one of {', '.join(_TYPES)}")
    return _TYPES[name]


def _require_known(elements: list[_Element]) -> tuple[str, ...]:
    """List the elements without surface with their counts; refuse unknown elements.

    Raises:
        MeshFormatError: vertex or face absent or twice, or an element that may hold a part of the surface.
    """
    names = [element.name for element in elements]
    if names.count("vertex") != 1 or names.count("face") != 1:
        raise MeshFormatError(f"elements {', '.join(names) or 'none'}; needed vertex and face, each once")
    for element in elements:
        properties = [name for name, *_ in element.properties]
        if element.count < 0 or len(set(properties)) < len(properties):
            raise MeshFormatError(f"element '{element.name}' has a negative count or a property twice")
        if element.name not in ("vertex", "face", *_WITHOUT_SURFACE) and element.count:
            raise MeshFormatError(
                f"{element.count} rows of '{element.name[:20]}' are not supported and may hold a part of the "
                "surface; export the mesh as triangles (elements vertex and face)"
            )
    if missing := [axis for axis in "xyz" if axis not in _named(elements, "vertex")]:
        raise MeshFormatError(f"its vertices have no {', '.join(missing)}")
    return tuple(f"{e.count} rows of '{e.name}'" for e in elements if e.name in _WITHOUT_SURFACE and e.count)


def _named(elements: list[_Element], name: str) -> dict[str, tuple[str, str | None]]:
    """Return the properties of an element: type, and the count type of a list."""
    element = next(e for e in elements if e.name == name)
    return {name: (kind, count_kind) for name, kind, count_kind in element.properties}


def _index_list(elements: list[_Element]) -> str:
    """Return the name of the list of face corners, the only integer list that faces may have."""
    face = _named(elements, "face")
    whole = [
        n for n, (kind, count_kind) in face.items() if count_kind and kind[0] != "f" and n != "texnumber"
    ]
    if len(whole) != 1 or whole[0] not in _INDEX_LISTS:
        raise MeshFormatError(
            f"its faces have no vertex_indices, or another list: {', '.join(face) or 'no properties'}; "
            "export the mesh again"
        )
    return whole[0]


def _ascii_tables(text: str, elements: list[_Element]) -> _Tables:
    rows = [line.split() for line in text_lines(text) if line.strip()]
    tables: _Tables = {}
    at = 0
    for element in elements:
        chunk = rows[at : at + element.count]
        at += element.count
        if len(chunk) < element.count:
            raise MeshFormatError(f"truncated: {len(chunk)} of {element.count} rows of '{element.name}'")
        cursors = [0] * len(chunk)
        table: dict[str, list[AnyArray] | AnyArray] = {}
        for name, _, count_kind in element.properties:
            if count_kind is None:
                table[name] = np.array([float(row[c]) for row, c in zip(chunk, cursors, strict=True)])
                cursors = [c + 1 for c in cursors]
                continue
            lengths = [_length(int(row[c]), element) for row, c in zip(chunk, cursors, strict=True)]
            spans = zip(chunk, cursors, lengths, strict=True)
            table[name] = [np.array(row[c + 1 : c + 1 + k], dtype=np.float64) for row, c, k in spans]
            cursors = [c + 1 + k for c, k in zip(cursors, lengths, strict=True)]
        for number, (row, cursor) in enumerate(zip(chunk, cursors, strict=True), 1):
            if len(row) != cursor:
                raise MeshFormatError(
                    f"row {number} of '{element.name}' has {len(row)} numbers; its header needs {cursor}"
                )
        tables[element.name] = table
    if at < len(rows):
        raise MeshFormatError(
            f"{len(rows) - at} rows follow the elements of its header, first {' '.join(rows[at])[:40]!r}; "
            "export the mesh again"
        )
    return tables


def _length(count: int, element: _Element) -> int:
    if count < 0:
        raise MeshFormatError(f"a list of '{element.name}' has {count} numbers")
    return count


def _binary_tables(body: memoryview, elements: list[_Element], order: str) -> tuple[_Tables, int]:
    """Read the elements by name, and return the position of the data after them."""
    tables: _Tables = {}
    at = 0
    for element in elements:
        lists = any(count_kind for _, _, count_kind in element.properties)
        lengths = _uniform_lengths(body, at, element, order) if lists else ()
        if lengths is None:
            table, at = _ragged(body, at, element, order)
        else:
            table, at = _records(body, at, element, order, lengths)
        tables[element.name] = table
    return tables, at


def _uniform_lengths(body: memoryview, at: int, element: _Element, order: str) -> tuple[int, ...] | None:
    """Return the list lengths of the first row if every row has the same, else None."""
    if element.count == 0:
        return (0,) * sum(1 for *_, kind in element.properties if kind)
    _, _, lengths = _row(body, at, element, order)
    record = _record_type(element, order, lengths)
    if at + record.itemsize * element.count > len(body):
        return None
    rows = np.frombuffer(body, record, element.count, at)
    names = [name for name, _, kind in element.properties if kind]
    same = all((rows[f"#{name}"] == k).all() for name, k in zip(names, lengths, strict=True))
    return lengths if same else None


def _records(
    body: memoryview, at: int, element: _Element, order: str, lengths: tuple[int, ...]
) -> tuple[dict[str, list[AnyArray] | AnyArray], int]:
    record = _record_type(element, order, lengths)
    needed = at + record.itemsize * element.count
    if needed > len(body):
        raise MeshFormatError(f"truncated: the data have {len(body)} bytes, '{element.name}' needs {needed}")
    rows = np.frombuffer(body, record, element.count, at)
    table: dict[str, list[AnyArray] | AnyArray] = {
        name: list(rows[name]) if kind else rows[name] for name, _, kind in element.properties
    }
    return table, needed


def _ragged(
    body: memoryview, at: int, element: _Element, order: str
) -> tuple[dict[str, list[AnyArray] | AnyArray], int]:
    table: dict[str, list[AnyArray]] = {name: [] for name, *_ in element.properties}
    for _ in range(element.count):
        values, at, _ = _row(body, at, element, order)
        for name, value in values.items():
            table[name].append(value)
    return {name: table[name] if kind else np.array(table[name]) for name, _, kind in element.properties}, at


def _row(
    body: memoryview, at: int, element: _Element, order: str
) -> tuple[dict[str, AnyArray], int, tuple[int, ...]]:
    """Read one row property by property: values, the position after it, and its list lengths."""
    values: dict[str, AnyArray] = {}
    lengths: list[int] = []
    for name, kind, count_kind in element.properties:
        count = 1
        if count_kind:
            count = _length(int(np.frombuffer(body, order + count_kind, 1, at)[0]), element)
            at += np.dtype(count_kind).itemsize
            lengths.append(count)
        data = np.frombuffer(body, order + kind, count, at)
        at += data.nbytes
        values[name] = data if count_kind else data[0]
    return values, at, tuple(lengths)


def _record_type(element: _Element, order: str, lengths: tuple[int, ...]) -> np.dtype[np.void]:
    fields: list[tuple[str, str] | tuple[str, str, int]] = []
    remaining = list(lengths)
    for name, kind, count_kind in element.properties:
        if count_kind:
            fields.append((f"#{name}", order + count_kind))
            fields.append((name, order + kind, remaining.pop(0)))
        else:
            fields.append((name, order + kind))
    return np.dtype(fields)
