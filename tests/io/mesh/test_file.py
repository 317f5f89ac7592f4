"""Meshes: four formats, the SPACE tag, real files, and files that are bad."""

import base64
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvf_ig.core import Mesh, OutputError, UnreadableFileError
from dvf_ig.io import read_mesh, write_mesh

CORNERS = np.array([[0.1, 0, 0], [10, 0.2, 0], [0, 10, 0.3], [0.4, 0, 10]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
ENDINGS = ["obj", "stl", "ply", "vtp"]


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32), ending=st.sampled_from(["obj", "ply", "vtp"]))
def test_round_trip_is_exact(tmp_path_factory: pytest.TempPathFactory, seed: int, ending: str) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 30))
    mesh = Mesh("mr", rng.normal(size=(n, 3)) * 10.0 ** rng.integers(-6, 6), rng.integers(0, n, (9, 3)))
    path = tmp_path_factory.mktemp("case") / f"m.{ending}"
    write_mesh(mesh, path)
    back = read_mesh(path)
    np.testing.assert_array_equal(back.vertices_mm, mesh.vertices_mm)
    np.testing.assert_array_equal(back.triangles, mesh.triangles)


def test_stl_keeps_shape_and_single_precision(tmp_path: Path) -> None:
    write_mesh(Mesh("mr", CORNERS, FACES), tmp_path / "m.stl")
    back = read_mesh(tmp_path / "m.stl")
    assert back.vertices_mm.shape == (4, 3)
    assert back.volume_mm3() == pytest.approx(Mesh("mr", CORNERS, FACES).volume_mm3(), rel=1e-6)


@pytest.mark.parametrize("ending", ["obj", "stl", "ply"])
def test_known_corner_read_by_open3d(tmp_path: Path, ending: str) -> None:
    import open3d

    write_mesh(Mesh("mr", CORNERS, FACES), tmp_path / f"m.{ending}")
    other = open3d.io.read_triangle_mesh(str(tmp_path / f"m.{ending}"))
    corners = np.asarray(other.vertices)[np.asarray(other.triangles)]
    np.testing.assert_allclose(corners, CORNERS[FACES], atol=1e-6)


@pytest.mark.parametrize(
    ("ending", "ascii_form"), [("obj", True), ("stl", False), ("ply", True), ("ply", False)]
)
def test_files_of_open3d(tmp_path: Path, ending: str, ascii_form: bool) -> None:
    import open3d

    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(CORNERS), open3d.utility.Vector3iVector(FACES)
    )
    mesh.compute_vertex_normals()
    path = tmp_path / f"m.{ending}"
    assert open3d.io.write_triangle_mesh(str(path), mesh, write_ascii=ascii_form)
    back = read_mesh(path)
    np.testing.assert_allclose(back.vertices_mm[back.triangles], CORNERS[FACES], atol=1e-5)


@pytest.mark.parametrize("ending", ENDINGS)
def test_space_tag(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"m.{ending}"
    write_mesh(Mesh("mr", CORNERS, FACES), path)
    data = path.read_bytes()
    if ending == "vtp":
        assert (
            b'<Array type="String" Name="SPACE" NumberOfTuples="1" format="ascii">76 80 83 0</Array>' in data
        )
        path.write_bytes(data.replace(b">76 80 83 0<", b">82 65 83 0<"))
    else:
        assert b"SPACE=LPS" in data[:200]
        path.write_bytes(data.replace(b"SPACE=LPS", b"SPACE=RAS"))
    turned = read_mesh(path)
    np.testing.assert_allclose(
        turned.vertices_mm[turned.triangles], (CORNERS * (-1, -1, 1))[FACES], atol=1e-6
    )
    path.write_bytes(
        path.read_bytes().replace(b"SPACE=RAS", b"SPACE=XYZ").replace(b">82 65 83 0<", b">88 0<")
    )
    with pytest.raises(UnreadableFileError, match="in the space 'X"):
        read_mesh(path)


def test_obj_dialects(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text(
        "# a square\nv 0 0 0\nv 1 0 0 1.0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\nvt 0 0\n"
        "f 1/1/1 2/1/1 3/1/1 4/1/1\nf -4//1 -3//1 -2//1\n"
    )
    assert read_mesh(tmp_path / "m.obj").triangles.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]


def test_ascii_stl(tmp_path: Path) -> None:
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in corner)
        + "endloop\nendfacet\n"
        for corner in CORNERS[FACES].tolist()
    )
    (tmp_path / "m.stl").write_text(f"solid SPACE=LPS\n{facets}endsolid\n")
    back = read_mesh(tmp_path / "m.stl")
    np.testing.assert_array_equal(back.vertices_mm[back.triangles], CORNERS[FACES])
    (tmp_path / "m.stl").write_text(f"solid x\n{facets[: len(facets) // 2]}")
    with pytest.raises(UnreadableFileError, match="truncated"):
        read_mesh(tmp_path / "m.stl")


def test_big_endian_ply_with_mixed_polygons_and_extras(tmp_path: Path) -> None:
    header = (
        "ply\nformat binary_big_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
        "property float z\nproperty uchar red\nelement face 2\nproperty uchar kind\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    body = b"".join(struct.pack(">3fB", *corner, 9) for corner in CORNERS)
    body += struct.pack(">BB3i", 1, 3, 0, 1, 2) + struct.pack(">BB4i", 1, 4, 0, 1, 2, 3)
    (tmp_path / "m.ply").write_bytes(header.encode() + body)
    back = read_mesh(tmp_path / "m.ply")
    assert back.triangles.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3]]
    np.testing.assert_allclose(back.vertices_mm, CORNERS, atol=1e-6)


def vtp(kind: str, word: str, *, compressed: bool, order: str = "<") -> bytes:
    """A VTP file as VTK lays it out: `kind` is ascii, binary, raw or base64 (the last two appended)."""
    width = {"UInt32": "I", "UInt64": "Q"}[word]
    arrays = [
        ("Float32", 'NumberOfComponents="3" Name="Points"', CORNERS.astype(order + "f4")),
        ("Int64", 'Name="connectivity"', FACES.ravel().astype(order + "i8")),
        ("Int64", 'Name="offsets"', (np.arange(1, 5) * 3).astype(order + "i8")),
    ]

    def block(data: bytes) -> bytes:
        encoded = kind in ("binary", "base64")
        if not compressed:
            whole = struct.pack(f"{order}{width}", len(data)) + data
            return base64.b64encode(whole) if encoded else whole
        half = max(len(data) // 2, 1)
        parts = [zlib.compress(data[i : i + half]) for i in range(0, len(data), half)]
        last = len(data) % half
        head = struct.pack(f"{order}{3 + len(parts)}{width}", len(parts), half, last, *map(len, parts))
        body = b"".join(parts)
        return base64.b64encode(head) + base64.b64encode(body) if encoded else head + body

    nodes, appended = [], b""
    for vtk_type, attributes, values in arrays:
        start = f'<DataArray type="{vtk_type}" {attributes} '.encode()
        if kind == "ascii":
            nodes.append(start + b'format="ascii">' + " ".join(map(str, values.ravel())).encode())
        elif kind == "binary":
            nodes.append(start + b'format="binary">\n  ' + block(values.tobytes()) + b"\n")
        else:
            nodes.append(start + f'format="appended" offset="{len(appended)}">'.encode())
            appended += block(values.tobytes())
    tail = b""
    if kind in ("raw", "base64"):
        tail = b'<AppendedData encoding="' + kind.encode() + b'">\n   _' + appended + b"\n  </AppendedData>"
    points, *polygons = (node + b"</DataArray>" for node in nodes)
    root = f'type="PolyData" version="1.0" header_type="{word}"'.encode()
    root += b' byte_order="' + (b"LittleEndian" if order == "<" else b"BigEndian") + b'"'
    if compressed:
        root += b' compressor="vtkZLibDataCompressor"'
    piece = b'<Piece NumberOfPoints="4" NumberOfPolys="4"><Points>' + points + b"</Points><Polys>"
    inner = b"<PolyData>" + piece + b"".join(polygons) + b"</Polys></Piece></PolyData>"
    return b'<?xml version="1.0"?>\n<VTKFile ' + root + b">" + inner + tail + b"</VTKFile>"


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("word", ["UInt32", "UInt64"])
@pytest.mark.parametrize("kind", ["ascii", "binary", "raw", "base64"])
def test_vtp_encodings(tmp_path: Path, kind: str, word: str, compressed: bool, order: str) -> None:
    (tmp_path / "m.vtp").write_bytes(vtp(kind, word, compressed=compressed, order=order))
    back = read_mesh(tmp_path / "m.vtp")
    np.testing.assert_allclose(back.vertices_mm, CORNERS, atol=1e-6)
    np.testing.assert_array_equal(back.triangles, FACES)


def test_real_vtp(data_dir: Path) -> None:
    mesh = read_mesh(data_dir / "heartdeform-wh" / "wh_template.vtp")
    assert mesh.vertices_mm.shape == (22827, 3)
    assert mesh.triangles.shape == (45626, 3)
    extent = np.ptp(mesh.vertices_mm, axis=0)
    assert extent.max() == pytest.approx(0.64, abs=0.01)
    assert mesh.volume_mm3() > 0


BAD = [
    ("m.obj", b"", "0 vertices and 0 faces"),
    ("m.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 9\n", "refers to vertex 8"),
    ("m.obj", b"v 0 0\nf 1 1 1\n", "m.obj"),
    ("m.stl", b"not a mesh", "neither a binary nor an ASCII STL"),
    ("m.stl", bytes(80) + struct.pack("<I", 5) + bytes(60), "5 triangles need 334"),
    ("m.ply", b"plum", "not a PLY file"),
    ("m.ply", b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nend_header\n1\n", "truncated"),
    ("m.ply", b"ply\nformat fancy 1.0\nend_header\n", "'fancy'"),
    ("m.vtp", b"<VTKFile", "not a VTP file"),
    ("m.vtp", b"<VTKFile type='ImageData'></VTKFile>", "holds VTK ImageData"),
    ("m.vtp", b"<VTKFile type='PolyData'><PolyData/></VTKFile>", "no Piece"),
    ("m.vtp", vtp("raw", "UInt32", compressed=True).replace(b"x\x9c", b"y\x9c"), "damaged"),
    ("m.vtp", vtp("ascii", "UInt32", compressed=False).replace(b'"4"', b'"5"'), "sizes that its header"),
    ("m.vtk", b"", "no known mesh ending"),
]


@pytest.mark.parametrize(("name", "data", "message"), BAD, ids=[f"{n} {m[:20]}" for n, _, m in BAD])
def test_bad_files(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(UnreadableFileError, match=message):
        read_mesh(tmp_path / name)


@pytest.mark.parametrize("ending", ENDINGS)
def test_truncated_files(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"m.{ending}"
    write_mesh(Mesh("mr", CORNERS, FACES), path)
    data = path.read_bytes()
    for keep in range(0, len(data) - 20, 11):
        path.write_bytes(data[:keep])
        try:
            mesh = read_mesh(path)
        except UnreadableFileError:
            continue
        assert ending == "obj"
        assert len(mesh.triangles) < len(FACES) or keep > len(data) - 30


def test_unknown_ending_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="unknown mesh ending"):
        write_mesh(Mesh("mr", CORNERS, FACES), tmp_path / "m.vtk")
