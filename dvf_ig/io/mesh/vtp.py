"""VTK XML PolyData (`.vtp`): polygons in ASCII, inline base64, or appended (raw or base64), plain or zlib."""

import base64
import re
import zlib
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from dvf_ig.core.arrays import AnyArray
from dvf_ig.io import limits

from .raw import MeshFormatError, RawMesh, fan_triangles

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
_APPENDED = re.compile(rb"<AppendedData\s+encoding\s*=\s*[\"'](raw|base64)[\"']\s*>\s*_")


@dataclass(frozen=True, slots=True)
class _Codec:
    """How the arrays of one file are stored."""

    order: str
    header: str
    compressed: bool
    appended: bytes
    appended_base64: bool

    def values(self, node: ElementTree.Element) -> AnyArray:
        """The numbers of a DataArray element."""
        kind = self.order + _TYPES[node.attrib["type"]]
        form = node.attrib.get("format", "ascii")
        if form == "ascii":
            return np.array((node.text or "").split(), dtype=np.float64).astype(kind)
        if form == "appended":
            block = self.appended[int(node.attrib["offset"]) :]
            return np.frombuffer(self._block(block, self.appended_base64), kind)
        return np.frombuffer(self._block("".join((node.text or "").split()).encode("ascii"), True), kind)

    def _block(self, data: bytes, is_base64: bool) -> bytes:
        """The bytes of one array: a size header, then plain or compressed data."""
        word = np.dtype(self.order + self.header)
        if not self.compressed:
            size = int(self._take(data, word.itemsize, is_base64, word)[0])
            return self._exactly(data, word.itemsize, size, is_base64)
        blocks, block_size, last_size = (int(v) for v in self._take(data, 3 * word.itemsize, is_base64, word))
        if blocks == 0:
            return b""
        if blocks * block_size > limits.TEXT_BYTES:
            raise MeshFormatError(
                f"an array states {blocks * block_size} bytes; at most {limits.TEXT_BYTES} are read"
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
        """The compressed bytes, which base64 encodes apart from the header before them."""
        start = -(-head // 3) * 4
        return base64.b64decode(data[start : start + -(-size // 3) * 4])[:size]

    def _take(self, data: bytes, size: int, is_base64: bool, word: np.dtype[np.void]) -> AnyArray:
        raw = base64.b64decode(data[: -(-size // 3) * 4])[:size] if is_base64 else data[:size]
        if len(raw) < size:
            raise MeshFormatError("truncated: an array ends within its size header")
        return np.frombuffer(raw, word)

    def _exactly(self, data: bytes, head: int, size: int, is_base64: bool) -> bytes:
        """`size` bytes after the header; plain base64 encodes header and data in one run."""
        if is_base64:
            raw = base64.b64decode(data[: -(-(head + size) // 3) * 4])[head : head + size]
        else:
            raw = data[head : head + size]
        if len(raw) != size:
            raise MeshFormatError(f"truncated: an array has {len(raw)} of {size} bytes")
        return raw


def decode_vtp(data: bytes) -> RawMesh:
    """Mesh of a VTP file: the polygons of all pieces; `cell_flags` holds their integer cell data."""
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
    pieces = [_piece(codec, piece) for piece in root.iter("Piece")]
    if not pieces:
        raise MeshFormatError("it has no Piece")
    shift = np.cumsum([0] + [len(piece.vertices) for piece in pieces])
    shared = set.intersection(*(set(piece.cell_flags) for piece in pieces))
    return RawMesh(
        np.concatenate([piece.vertices for piece in pieces]),
        np.concatenate([p.triangles + s for p, s in zip(pieces, shift[:-1], strict=True)]),
        _space(codec, root),
        {name: np.concatenate([piece.cell_flags[name] for piece in pieces]) for name in sorted(shared)},
    )


def encode_vtp(mesh: RawMesh) -> bytes:
    """VTP with 64-bit coordinates inline in base64 and the SPACE tag as 3D Slicer's field data."""
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
    """A block of compressed data, of which no more is unpacked than its header says."""
    inflater = zlib.decompressobj()
    out = inflater.decompress(part, most + 1)
    if len(out) > most or not inflater.eof:
        raise MeshFormatError(f"a block of compressed data does not unpack to the {most} bytes of its header")
    return out


def _split_appended(data: bytes) -> tuple[bytes, bytes, bool]:
    """The XML without its appended block, that block, and whether it is base64."""
    start = _APPENDED.search(data)
    if start is None:
        return data, b"", False
    end = data.rfind(b"</AppendedData>")
    stop = end if end > 0 else len(data)
    xml = data[: start.start()] + (data[stop + len(b"</AppendedData>") :] if end > 0 else b"</VTKFile>")
    return xml, data[start.end() : stop], start[1] == b"base64"


def _piece(codec: _Codec, piece: ElementTree.Element) -> RawMesh:
    points = piece.find("Points/DataArray")
    arrays = {node.attrib.get("Name", ""): node for node in piece.findall("Polys/DataArray")}
    if points is None or not {"connectivity", "offsets"} <= arrays.keys():
        raise MeshFormatError("a piece lacks points or polygons")
    vertices = codec.values(points).astype(np.float64).reshape(-1, 3)
    corners = codec.values(arrays["connectivity"]).astype(np.int64)
    ends = codec.values(arrays["offsets"]).astype(np.int64)
    counts = np.diff(ends, prepend=0)
    if (
        len(vertices) != int(piece.attrib["NumberOfPoints"])
        or (counts < 0).any()
        or (len(ends) and ends[-1] != len(corners))
    ):
        raise MeshFormatError("its arrays do not have the sizes that its header states")
    triangles, owner = fan_triangles(corners, ends - counts, counts)
    before = sum(int(piece.attrib.get(f"NumberOf{kind}", 0)) for kind in ("Verts", "Lines"))
    flags = {
        node.attrib.get("Name", ""): codec.values(node)[before:][owner]
        for node in piece.findall("CellData/DataArray")
        if node.attrib["type"].lstrip("U").startswith("Int")
        and node.attrib.get("NumberOfComponents", "1") == "1"
    }
    return RawMesh(vertices, triangles, "", flags)


def _space(codec: _Codec, root: ElementTree.Element) -> str:
    """ "SPACE=<name>" from 3D Slicer's field data, or an empty string."""
    for node in root.iter("Array"):
        if node.attrib.get("Name") == "SPACE" and node.attrib.get("type") == "String":
            if node.attrib.get("format", "ascii") == "ascii":
                codes = bytes(int(code) for code in (node.text or "").split())
            else:
                node.attrib["type"] = "UInt8"
                codes = codec.values(node).tobytes()
            return f"SPACE={codes.rstrip(bytes(1)).decode('ascii', 'replace')}"
    return ""
