"""STL, ASCII and binary: a triangle soup whose exactly coinciding vertices are merged."""

import numpy as np

from dvf_ig.core.arrays import FloatArray

from .raw import MeshFormatError, RawMesh

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER_BYTES = 80


def decode_stl(data: bytes) -> RawMesh:
    """Mesh of an STL file; told to be binary where its size agrees with its triangle count."""
    if len(data) >= _HEADER_BYTES + 4:
        count = int.from_bytes(data[_HEADER_BYTES : _HEADER_BYTES + 4], "little")
        needed = _HEADER_BYTES + 4 + count * _RECORD.itemsize
        if len(data) == needed:
            records = np.frombuffer(data, _RECORD, count, _HEADER_BYTES + 4)
            return _welded(records["corners"], data[:_HEADER_BYTES].decode("latin-1"))
        if not data.lstrip().startswith(b"solid"):
            raise MeshFormatError(f"the file has {len(data)} bytes, its {count} triangles need {needed}")
    return _decode_ascii(data)


def _decode_ascii(data: bytes) -> RawMesh:
    lines = data.decode("latin-1").splitlines()
    if not lines or not lines[0].lstrip().startswith("solid"):
        raise MeshFormatError("neither a binary nor an ASCII STL file")
    rows = [line.split()[1:4] for line in lines if line.lstrip().startswith("vertex")]
    if not rows or len(rows) % 3 or not any(line.strip().startswith("endsolid") for line in lines):
        raise MeshFormatError(f"{len(rows)} vertices of triangles and no proper end; the file is truncated")
    return _welded(np.array(rows, dtype=np.float64).reshape(-1, 3, 3), lines[0])


def _welded(corners: FloatArray, note: str) -> RawMesh:
    """Merge equal corners; numbering follows first appearance, so that corresponding files stay alike."""
    if not np.isfinite(corners).all():
        raise MeshFormatError("a corner is not finite; export it again")
    points = corners.reshape(-1, 3).astype(np.float64)
    _, first, inverse = np.unique(points, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return RawMesh(points[first[order]], rank[inverse.reshape(-1)].reshape(-1, 3), note)


def encode_stl(mesh: RawMesh) -> bytes:
    """Binary STL, 32-bit floats, the SPACE tag in its header."""
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    records = np.zeros(len(corners), _RECORD)
    records["normal"] = normals / np.where(length > 0, length, 1.0)
    records["corners"] = corners
    header = f"dvf_ig {mesh.note}".encode("ascii").ljust(_HEADER_BYTES, b" ")
    return header + len(corners).to_bytes(4, "little") + records.tobytes()
