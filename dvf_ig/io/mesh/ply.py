"""PLY, ASCII and binary of either byte order: the elements `vertex` (x, y, z) and `face` (vertex lists)."""

from dataclasses import dataclass, field

import numpy as np

from dvf_ig.core.arrays import AnyArray

from .raw import MeshFormatError, RawMesh, fan_triangles

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


@dataclass(slots=True)
class _Element:
    """One element of the header; `properties` holds name, type, and the count type of a list (or None)."""

    name: str
    count: int
    properties: list[tuple[str, str, str | None]] = field(default_factory=list)


def decode_ply(data: bytes) -> RawMesh:
    """Mesh of a PLY file."""
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise MeshFormatError("not a PLY file (no 'ply' … 'end_header')")
    body = data.index(b"\n", end) + 1
    form, elements, note = _header(data[:end].decode("ascii", "replace"))
    if form == "ascii":
        tables = _ascii_tables(data[body:].decode("ascii", "replace"), elements)
    else:
        tables = _binary_tables(memoryview(data)[body:], elements, "<" if "little" in form else ">")
    if "vertex" not in tables or "face" not in tables:
        raise MeshFormatError(f"elements {', '.join(tables) or 'none'}; needed vertex and face")
    vertex, face = tables["vertex"], tables["face"]
    lists = face.get("vertex_indices", face.get("vertex_index"))
    if lists is None:
        raise MeshFormatError("its faces have no vertex_indices")
    counts = np.array([len(polygon) for polygon in lists], dtype=np.int64)
    corners = np.concatenate(lists).astype(np.int64) if len(lists) else np.zeros(0, np.int64)
    triangles, _ = fan_triangles(corners, np.cumsum(counts) - counts, counts)
    points = np.stack([np.asarray(vertex[axis], dtype=np.float64) for axis in "xyz"], axis=1)
    return RawMesh(points, triangles, note)


def encode_ply(mesh: RawMesh) -> bytes:
    """Binary little-endian PLY with 64-bit coordinates and the SPACE tag in a comment."""
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
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["format"]:
            form = words[1]
        elif words[:1] in (["comment"], ["obj_info"]):
            notes.append(line)
        elif words[:1] == ["element"]:
            elements.append(_Element(words[1], int(words[2])))
        elif words[:2] == ["property", "list"]:
            elements[-1].properties.append((words[4], _TYPES[words[3]], _TYPES[words[2]]))
        elif words[:1] == ["property"]:
            elements[-1].properties.append((words[2], _TYPES[words[1]], None))
    if form not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise MeshFormatError(f"PLY format '{form}' is not known")
    return form, elements, "\n".join(notes)


def _ascii_tables(text: str, elements: list[_Element]) -> dict[str, dict[str, list[AnyArray] | AnyArray]]:
    rows = [line.split() for line in text.splitlines() if line.strip()]
    tables: dict[str, dict[str, list[AnyArray] | AnyArray]] = {}
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
            lengths = [int(row[c]) for row, c in zip(chunk, cursors, strict=True)]
            spans = zip(chunk, cursors, lengths, strict=True)
            table[name] = [np.array(row[c + 1 : c + 1 + k], dtype=np.float64) for row, c, k in spans]
            cursors = [c + 1 + k for c, k in zip(cursors, lengths, strict=True)]
        tables[element.name] = table
    return tables


def _binary_tables(
    body: memoryview, elements: list[_Element], order: str
) -> dict[str, dict[str, list[AnyArray] | AnyArray]]:
    tables: dict[str, dict[str, list[AnyArray] | AnyArray]] = {}
    at = 0
    for element in elements:
        lists = any(count_kind for _, _, count_kind in element.properties)
        lengths = _uniform_lengths(body, at, element, order) if lists else ()
        if lengths is None:
            table, at = _ragged(body, at, element, order)
        else:
            table, at = _records(body, at, element, order, lengths)
        tables[element.name] = table
    return tables


def _uniform_lengths(body: memoryview, at: int, element: _Element, order: str) -> tuple[int, ...] | None:
    """Lengths of the list properties where every row has those of the first, else None."""
    if element.count == 0:
        return (0,) * sum(1 for *_, kind in element.properties if kind)
    _, _, lengths = _row(body, at, element, order)
    record = _record_type(element, order, lengths)
    if at + record.itemsize * element.count > len(body):
        return None
    rows = np.frombuffer(body, record, element.count, at)
    same = all((rows[f"#{name}"] == k).all() for name, k in zip(_list_names(element), lengths, strict=True))
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
    """One row read property by property: values, the position after it, and its list lengths."""
    values: dict[str, AnyArray] = {}
    lengths: list[int] = []
    for name, kind, count_kind in element.properties:
        count = 1
        if count_kind:
            count = int(np.frombuffer(body, order + count_kind, 1, at)[0])
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


def _list_names(element: _Element) -> list[str]:
    return [name for name, _, kind in element.properties if kind]
