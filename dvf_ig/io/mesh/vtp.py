"""Read and write VTK XML PolyData (`.vtp`): polygons and triangle strips.

Arrays are ASCII, inline base64, or appended (raw or base64), plain or zlib.
"""

import base64
import re
import zlib
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from dvf_ig.core.arrays import AnyArray, IntArray
from dvf_ig.io import limits

from .raw import MeshFormatError, RawMesh, fan_triangles, strip_triangles, whole_indices

_TYPES = {
    "Int8": "i1",
    "UInt8": "u1",
    "Int16": "i2",
    "UInt16": "u2",
    "Int32": "i4",
    "UInt32": "u4",
    "Int64": "i8",
    "UInt64": "u8",
    "Float32": "f4",
    "Float64": "f8",
}
_CELLS = ("Verts", "Lines", "Polys", "Strips")
"""Kinds of cells, in the order of their cell data."""
_GHOSTS = ("vtkGhostType", "vtkGhostLevels")
_APPENDED = re.compile(rb"<AppendedData\s+encoding\s*=\s*[\"'](raw|base64)[\"']\s*>\s*_")


@dataclass(frozen=True, slots=True)
class _Codec:
    """Storage of the arrays of one file."""

    order: str
    header: str
    compressed: bool
    appended: bytes
    appended_base64: bool

    def values(self, node: ElementTree.Element) -> AnyArray:
        """Decode the numbers of a DataArray element."""
        kind = self.order + _TYPES[node.attrib["type"]]
        form = node.attrib.get("format", "ascii")
        if form == "ascii":
            numbers = np.array((node.text or "").split(), dtype=np.float64)
            if not kind.endswith(("f4", "f8")) and (numbers != np.floor(numbers)).any():
                raise MeshFormatError(
                    f"array '{node.attrib.get('Name', '')}' holds numbers that are not whole"
                )
            return numbers.astype(kind)
        if form == "appended":
            block = self.appended[int(node.attrib["offset"]) :]
            return np.frombuffer(self._block(block, self.appended_base64), kind)
        return np.frombuffer(self._block("".join((node.text or "").split()).encode("ascii"), True), kind)

    def _block(self, data: bytes, is_base64: bool) -> bytes:
        """Decode the bytes of one array: a size header, then plain or compressed data."""
        word = np.dtype(self.order + self.header)
        if not self.compressed:
            size = int(self._take(data, word.itemsize, is_base64, word)[0])
            return self._exactly(data, word.itemsize, size, is_base64)
        blocks, block_size, last_size = (int(v) for v in self._take(data, 3 * word.itemsize, is_base64, word))
        if blocks == 0:
            return b""
        if blocks * block_size > limits.TEXT_BYTES:
            raise MeshFormatError(
                f"an array states {blocks * block_size} bytes; at most {limits.TEXT_BYTES} can be read"
            )
        head = (3 + blocks) * word.itemsize
        sizes = self._take(data, head, is_base64, word)[3:]
        total = int(sizes.sum())
        payload = self._second_run(data, head, total) if is_base64 else data[head : head + total]
        ends = np.cumsum(sizes)
        parts = [payload[int(e - s) : int(e)] for e, s in zip(ends, sizes, strict=True)]
        try:
            out = b"".join(_unpacked(part, block_size) for part in parts)
        except zlib.error as exc:
            raise MeshFormatError(f"damaged compressed data ({exc})") from exc
        expected = (blocks - 1) * block_size + (last_size or block_size)
        if len(out) != expected:
            raise MeshFormatError(f"an array has {len(out)} bytes, its header says {expected}")
        return out

    def _second_run(self, data: bytes, head: int, size: int) -> bytes:
        """Decode the compressed bytes, which base64 encodes separately from the header before them."""
        start = -(-head // 3) * 4
        return base64.b64decode(data[start : start + -(-size // 3) * 4])[:size]

    def _take(self, data: bytes, size: int, is_base64: bool, word: np.dtype[np.void]) -> AnyArray:
        raw = base64.b64decode(data[: -(-size // 3) * 4])[:size] if is_base64 else data[:size]
        if len(raw) < size:
            raise MeshFormatError("truncated: an array ends within its size header")
        return np.frombuffer(raw, word)

    def _exactly(self, data: bytes, head: int, size: int, is_base64: bool) -> bytes:
        """Read `size` bytes after the header; plain base64 encodes header and data together."""
        if is_base64:
            raw = base64.b64decode(data[: -(-(head + size) // 3) * 4])[head : head + size]
        else:
            raw = data[head : head + size]
        if len(raw) != size:
            raise MeshFormatError(f"truncated: an array has {len(raw)} of {size} bytes")
        return raw


def decode_vtp(data: bytes) -> RawMesh:
    """Decode a VTP file: the polygons and triangle strips of all pieces.

    `cell_flags` holds their integer cell data; vertex and line cells are counted in `left_out`.
    """
    xml, appended, is_base64 = _split_appended(data)
    try:
        root = ElementTree.fromstring(xml)
    except ElementTree.ParseError as exc:
        raise MeshFormatError(f"not a VTP file ({exc})") from exc
    if root.tag != "VTKFile" or root.attrib.get("type") != "PolyData":
        raise MeshFormatError(f"holds VTK {root.attrib.get('type', root.tag)}; needed PolyData")
    compressor = root.attrib.get("compressor", "")
    if compressor not in ("", "vtkZLibDataCompressor"):
        raise MeshFormatError(f"compressed with {compressor}; save it with zlib or without compression")
    order = "<" if root.attrib.get("byte_order", "LittleEndian") == "LittleEndian" else ">"
    header = _TYPES[root.attrib.get("header_type", "UInt32")]
    codec = _Codec(order, header, bool(compressor), appended, is_base64)
    _require_known(root, {"PolyData", "AppendedData"})
    data_sets = root.findall("PolyData")
    for data_set in data_sets:
        _require_known(data_set, {"FieldData", "Piece"})
    pieces = [_piece(codec, piece) for data_set in data_sets for piece in data_set.findall("Piece")]
    if not pieces:
        raise MeshFormatError("it has no Piece")
    shift = np.cumsum([0] + [len(piece.vertices) for piece in pieces])
    filled = [piece for piece in pieces if len(piece.triangles)]
    names = {tuple(sorted(piece.cell_flags)) for piece in filled}
    if len(names) > 1:
        raise MeshFormatError(f"its pieces have different cell data ({sorted(names)}); save it as one piece")
    return RawMesh(
        np.concatenate([piece.vertices for piece in pieces]),
        np.concatenate([p.triangles + s for p, s in zip(pieces, shift[:-1], strict=True)]),
        _space(codec, root),
        {
            name: np.concatenate([piece.cell_flags[name] for piece in filled])
            for name in (names.pop() if names else ())
        },
        _left_out(data_sets),
    )


def encode_vtp(mesh: RawMesh) -> bytes:
    """Encode VTP with inline base64 64-bit coordinates and the SPACE tag as 3D Slicer's field data."""
    space = " ".join(str(code) for code in mesh.note.removeprefix("SPACE=").encode("ascii"))
    offsets = np.arange(1, len(mesh.triangles) + 1, dtype=np.int64) * 3
    flags = "".join(_array_xml(name, values.astype(np.uint8)) for name, values in mesh.cell_flags.items())
    return (
        '<?xml version="1.0"?>\n'
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n'
        "<PolyData>\n"
        f'<FieldData><Array type="String" Name="SPACE" NumberOfTuples="1" format="ascii">{space} 0</Array>'
        "</FieldData>\n"
        f'<Piece NumberOfPoints="{len(mesh.vertices)}" NumberOfVerts="0" NumberOfLines="0" '
        f'NumberOfStrips="0" NumberOfPolys="{len(mesh.triangles)}">\n'
        f"<PointData></PointData>\n<CellData>{flags}</CellData>\n"
        f"<Points>{_array_xml('Points', mesh.vertices.astype(np.float64), 3)}</Points>\n"
        f"<Polys>{_array_xml('connectivity', mesh.triangles.astype(np.int64).ravel())}"
        f"{_array_xml('offsets', offsets)}</Polys>\n"
        "</Piece>\n</PolyData>\n</VTKFile>\n"
    ).encode("ascii")


def _array_xml(name: str, values: AnyArray, components: int = 1) -> str:
    kind = next(vtk for vtk, code in _TYPES.items() if np.dtype(code) == values.dtype)
    raw = np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<")).tobytes()
    text = base64.b64encode(len(raw).to_bytes(8, "little") + raw).decode("ascii")
    return (
        f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" format="binary">{text}'
        "</DataArray>"
    )


def _unpacked(part: bytes, most: int) -> bytes:
    """Decompress a block to at most the size that its header states."""
    inflater = zlib.decompressobj()
    out = inflater.decompress(part, most + 1)
    if len(out) > most or not inflater.eof:
        raise MeshFormatError(f"a block of compressed data does not unpack to the {most} bytes of its header")
    return out


def _split_appended(data: bytes) -> tuple[bytes, bytes, bool]:
    """Return the XML without its appended block, that block, and whether it is base64."""
    start = _APPENDED.search(data)
    if start is None:
        return data, b"", False
    end = data.rfind(b"</AppendedData>")
    stop = end if end > 0 else len(data)
    xml = data[: start.start()] + (data[stop + len(b"</AppendedData>") :] if end > 0 else b"</VTKFile>")
    return xml, data[start.end() : stop], start[1] == b"base64"


def _require_known(node: ElementTree.Element, supported: set[str]) -> None:
    """Raise MeshFormatError for a child not among `known`: it may hold a part of the surface."""
    for child in node:
        if child.tag not in supported:
            raise MeshFormatError(
                f"its {node.tag} holds the unsupported '{child.tag}'; save it as PolyData of triangles"
            )


def _piece(codec: _Codec, piece: ElementTree.Element) -> RawMesh:
    _require_known(piece, {"PointData", "CellData", "Points", *_CELLS})
    if any(len(piece.findall(child.tag)) > 1 for child in piece):
        raise MeshFormatError("a piece holds one of its parts twice; save it again")
    points = piece.findall("Points/DataArray")
    if len(points) != 1:
        raise MeshFormatError(f"a piece has {len(points)} arrays of points; needed one")
    vertices = codec.values(points[0]).astype(np.float64).reshape(-1, 3)
    if len(vertices) != int(piece.attrib["NumberOfPoints"]):
        raise MeshFormatError(
            f"{len(vertices)} points do not have the sizes that its header states "
            f"({piece.attrib['NumberOfPoints']}); save it again"
        )
    cells = {kind: _cells(codec, piece, kind, len(vertices)) for kind in _CELLS}
    polygons, owner = fan_triangles(*cells["Polys"])
    strips, strip_owner = strip_triangles(*cells["Strips"])
    # the order of cell data: vertices, lines, polygons, strips
    before = [len(counts) for _, counts in cells.values()]
    owners = np.concatenate([owner + sum(before[:2]), strip_owner + sum(before[:3])])
    flags = _cell_flags(codec, piece, sum(before), owners)
    return RawMesh(vertices, np.concatenate([polygons, strips]), "", flags)


def _cells(codec: _Codec, piece: ElementTree.Element, kind: str, vertices: int) -> tuple[IntArray, IntArray]:
    """Return the vertex indices of the cells of one kind, concatenated, and the count of each cell."""
    arrays = {node.attrib.get("Name", ""): node for node in piece.findall(f"{kind}/DataArray")}
    stated = piece.attrib.get(f"NumberOf{kind}")
    if len(arrays) < len(piece.findall(f"{kind}/DataArray")):
        raise MeshFormatError(f"its {kind} hold an array twice; save it again")
    if not arrays and int(stated or 0) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    if not {"connectivity", "offsets"} <= arrays.keys():
        raise MeshFormatError(f"a piece states {stated} {kind} and lacks their connectivity or offsets")
    corners = codec.values(arrays["connectivity"])
    ends = codec.values(arrays["offsets"]).astype(np.int64)
    counts = np.diff(ends, prepend=0)
    end = int(ends[-1]) if len(ends) else 0
    if (counts < 0).any() or end != len(corners) or int(stated or 0) != len(ends):
        raise MeshFormatError(
            f"its {kind} do not have the sizes that its header states: NumberOf{kind} is {stated}, "
            f"{len(ends)} offsets lead to {end} of {len(corners)} corners; save it again"
        )
    return whole_indices(corners, vertices, "cell"), counts


def _cell_flags(
    codec: _Codec, piece: ElementTree.Element, cells: int, owners: IntArray
) -> dict[str, AnyArray]:
    """Return integer cell data of one component, by name, for each triangle.

    Raises:
        MeshFormatError: not one value per cell, or cells that other pieces also hold ("ghosts").
    """
    flags: dict[str, AnyArray] = {}
    for node in piece.findall("CellData/DataArray"):
        name = node.attrib.get("Name", "")
        whole = node.attrib["type"].lstrip("U").startswith("Int")
        if not whole or node.attrib.get("NumberOfComponents", "1") != "1":
            continue
        values = codec.values(node)
        if len(values) != cells:
            raise MeshFormatError(
                f"cell data '{name}' have {len(values)} values for {cells} cells; save it again"
            )
        if name in _GHOSTS and values.any():
            raise MeshFormatError(
                f"{np.count_nonzero(values)} of {cells} cells are hidden or repeated ('{name}'); save the "
                "whole surface as one piece without ghost cells"
            )
        flags[name] = values[owners]
    return flags


def _left_out(data_sets: list[ElementTree.Element]) -> tuple[str, ...]:
    """List the cells without area, each kind with its count."""
    counts = []
    for kind, name in (("Verts", "vertex cells"), ("Lines", "line cells")):
        count = sum(
            int(p.attrib.get(f"NumberOf{kind}", 0)) for data in data_sets for p in data.findall("Piece")
        )
        counts += [f"{count} {name}"] if count else []
    return tuple(counts)


def _space(codec: _Codec, root: ElementTree.Element) -> str:
    """Return "SPACE=<name>" from 3D Slicer's field data, or an empty string."""
    for node in root.iter("Array"):
        if node.attrib.get("Name") == "SPACE" and node.attrib.get("type") == "String":
            if node.attrib.get("format", "ascii") == "ascii":
                codes = bytes(int(code) for code in (node.text or "").split())
            else:
                node.attrib["type"] = "UInt8"
                codes = codec.values(node).tobytes()
            return f"SPACE={codes.rstrip(bytes(1)).decode('ascii', 'replace')}"
    return ""
