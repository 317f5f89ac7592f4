"""Every part of a mesh file is read, named in a warning, or refused."""

import gzip
import io
import logging
import struct
import tarfile
from pathlib import Path

import numpy as np
import pytest

from dvf_ig.core import CycleTiming, FloatArray, IntArray, Mesh, SurfaceSeries, UnreadableFileError
from dvf_ig.core.space.mesh import enclosed_volume_mm3
from dvf_ig.intake import describe
from dvf_ig.io import read_mesh, read_surface_series, surface_names, write_mesh, write_surface_series
from dvf_ig.io.mesh.raw import RawMesh
from dvf_ig.io.mesh.stl import encode_stl

CORNERS = np.array([[0.0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
SECTORS, RINGS = 24, 11
SEMI_AXES = np.array([40.0, 36.0, 48.0])


def heart() -> tuple[FloatArray, IntArray, list[list[int]]]:
    """A closed ellipsoid as triangles and, for each of its sectors, as one strip from pole to pole."""
    polar = np.linspace(0, np.pi, RINGS + 2)[1:-1]
    turn = np.arange(SECTORS) * 2 * np.pi / SECTORS
    theta, phi = (a.ravel() for a in np.meshgrid(polar, turn, indexing="ij"))
    ring = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    vertices = SEMI_AXES * np.vstack([ring, [[0, 0, 1.0], [0, 0, -1.0]]])
    top, bottom = len(ring), len(ring) + 1
    strips = []
    for one in range(SECTORS):
        other = (one + 1) % SECTORS
        zigzag = [SECTORS * r + s for r in range(RINGS) for s in (one, other)]
        strips.append([top, *zigzag, bottom])
    triangles = []
    for strip in strips:
        for i, (a, b, c) in enumerate(zip(strip, strip[1:], strip[2:], strict=False)):
            triangles.append([a, c, b] if i % 2 else [a, b, c])
    return vertices, np.array(triangles), strips


def vtp(vertices: FloatArray, cells: dict[str, list[list[int]]], more: str = "", stated: str = "") -> str:
    """An ASCII VTP piece with cells of any kind; `stated` takes the place of the counts in its header."""
    counts = stated or " ".join(f'NumberOf{kind}="{len(of)}"' for kind, of in cells.items())
    parts = []
    for kind, of in cells.items():
        corners = " ".join(str(v) for cell in of for v in cell)
        ends = " ".join(map(str, np.cumsum([len(cell) for cell in of]).tolist()))
        parts.append(
            f'<{kind}><DataArray type="Int64" Name="connectivity" format="ascii">{corners}</DataArray>'
            f'<DataArray type="Int64" Name="offsets" format="ascii">{ends}</DataArray></{kind}>'
        )
    points = " ".join(map(repr, vertices.ravel().tolist()))
    return (
        f'<Piece NumberOfPoints="{len(vertices)}" {counts}><Points><DataArray type="Float64" Name="Points" '
        f'NumberOfComponents="3" format="ascii">{points}</DataArray></Points>{"".join(parts)}{more}</Piece>'
    )


def vtp_file(*pieces: str) -> str:
    return f'<VTKFile type="PolyData" version="1.0"><PolyData>{"".join(pieces)}</PolyData></VTKFile>'


def is_closed(triangles: IntArray) -> bool:
    edges = [tuple(e) for t in triangles.tolist() for e in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0]))]
    return len(set(edges)) == len(edges) and all((b, a) in set(edges) for a, b in edges[:50])


@pytest.mark.parametrize("in_strips", [SECTORS, SECTORS // 2])
def test_strips_are_triangles_of_the_surface(tmp_path: Path, in_strips: int) -> None:
    vertices, triangles, strips = heart()
    per = len(triangles) // SECTORS
    polygons = triangles[in_strips * per :].tolist()
    (tmp_path / "m.vtp").write_text(
        vtp_file(vtp(vertices, {"Strips": strips[:in_strips], "Polys": polygons}))
    )
    mesh = read_mesh(tmp_path / "m.vtp")
    assert len(mesh.triangles) == len(triangles) == 528
    assert is_closed(mesh.triangles)
    assert mesh.volume_mm3() == pytest.approx(abs(enclosed_volume_mm3(vertices, triangles)))


def test_cell_data_follow_their_cells(tmp_path: Path) -> None:
    """VTK counts vertices, lines, polygons, strips, whatever their order in the file."""
    cap = '<CellData><DataArray type="UInt8" Name="Cap" format="ascii">0 0 0 1 0 1</DataArray></CellData>'
    cells = {
        "Strips": [[1, 2, 3]],
        "Polys": [[0, 2, 1], [0, 1, 3], [0, 3, 2]],
        "Lines": [[0, 1]],
        "Verts": [[0]],
    }
    for i in range(2):
        (tmp_path / f"S_{i}.vtp").write_text(vtp_file(vtp(CORNERS, cells, cap)))
    series = read_surface_series(tmp_path, "S")
    assert series.triangles.tolist() == [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    assert series.caps.tolist() == [False, True, False, True]


PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
BINARY = encode_stl(RawMesh(CORNERS, FACES, "SPACE=LPS"))
FAN = "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
VERTICES = "v 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\n"
NAMED = [
    ("m.obj", VERTICES + FAN + "p 1 2\nl 1 2\nl 3 4\n", "1 points, 2 lines"),
    (
        "m.vtp",
        vtp_file(vtp(CORNERS, {"Verts": [[0]], "Lines": [[0, 1], [1, 2]], "Polys": FACES.tolist()})),
        "1 vertex cells, 2 line cells",
    ),
    (
        "m.ply",
        PLY.replace("vertex 3", "vertex 4")
        + "element face 4\nproperty list uchar int vertex_index\nelement edge 1\nproperty int vertex1\n"
        "property int vertex2\nend_header\n0 0 0\n10 0 0\n0 10 0\n0 0 10\n"
        "3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n0 1\n",
        "1 rows of 'edge'",
    ),
    ("m.obj", VERTICES + FAN + "f 1 2 2\n", "1 triangles that name a vertex twice"),
    ("m.stl", BINARY + b"\r\n", "2 bytes after the 4 triangles"),
    ("m.stl", BINARY + bytes(500), "500 bytes after the 4 triangles"),
]


@pytest.mark.parametrize(("name", "data", "told"), NAMED, ids=[told[:30] for *_, told in NAMED])
def test_what_has_no_area_is_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, name: str, data: str | bytes, told: str
) -> None:
    (tmp_path / name).write_bytes(data.encode() if isinstance(data, str) else data)
    with caplog.at_level(logging.WARNING, "dvf_ig"):
        mesh = read_mesh(tmp_path / name)
    np.testing.assert_allclose(mesh.vertices_mm[mesh.triangles[:4]], CORNERS[FACES])
    assert len(mesh.triangles) == 4 + ("twice" in told)
    assert [r.getMessage().split(": ", 1)[1] for r in caplog.records] == [
        f"{told} have no area and add nothing to the surface"
    ]


PLY_FACE = "element face 1\nproperty list uchar int vertex_indices\n"
PLY_HEAD = PLY_FACE + "end_header\n0 0 0\n1 0 0\n0 1 0\n"
PLY_ROWS = "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
FACET = "facet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
FOUR_CORNERS = FACET.replace("endloop", "vertex 1 1 1\nendloop")
POLYS = {"Polys": FACES.tolist()}
SURFACE = vtp(CORNERS, POLYS)
GHOSTS = '<CellData><DataArray type="UInt8" Name="vtkGhostType" format="ascii">0 0 1 0</DataArray></CellData>'
SHORT = '<CellData><DataArray type="UInt8" Name="Cap" format="ascii">0 1</DataArray></CellData>'

REFUSED = [
    ("m.obj", VERTICES + FAN + "curv 0 1 1 2\n", "'curv' is unsupported and may hold a part of the surface"),
    ("m.obj", VERTICES + FAN + "surf 0 1 0 1 1 2 3 4\n", "'surf' is unsupported"),
    ("m.obj", VERTICES + FAN + "fo 1 2 3\n", "'fo' is unsupported"),
    ("m.obj", VERTICES + FAN + "f 1 2\n", "1 of 5 polygons have fewer than 3 corners, first number 5"),
    ("m.obj", VERTICES + FAN + "f 0 1 2\n", "a face refers to vertex 0"),
    ("m.obj", VERTICES + FAN + "f -5 -1 -2\n", "a face refers to vertex -5"),
    ("m.obj", VERTICES + FAN + "f 1 2 9\n", "refers to vertex 8"),
    ("m.obj", "v 1 2 3 0.5\n" + VERTICES + FAN, "vertex 1 is '1 2 3 0.5'"),
    ("m.obj", "v nan 0 0\n" + VERTICES + FAN, "not finite"),
    ("m.obj", "# SPACE=LPS\n# SPACE=RAS\n" + VERTICES + FAN, "'LPS, RAS'"),
    ("m.obj", VERTICES + FAN + "3 1 2 3\n", "'3' is unsupported"),
    (
        "m.ply",
        PLY
        + PLY_FACE
        + "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
        + PLY_ROWS
        + "3 0 1 2\n",
        "1 rows of 'tristrips' are not supported and may hold a part of the surface",
    ),
    (
        "m.ply",
        PLY + "element face 1\nproperty list uchar int corners\nend_header\n" + PLY_ROWS,
        "no vertex_indices, or another list: corners",
    ),
    (
        "m.ply",
        PLY + PLY_FACE + "property list uchar int strip\nend_header\n" + PLY_ROWS[:-1] + " 1 0\n",
        "another list: vertex_indices, strip",
    ),
    ("m.ply", PLY + PLY_FACE + "end_header\n" + PLY_ROWS + "3 0 1 2\n", "1 rows follow the elements"),
    ("m.ply", PLY + PLY_HEAD + "3 0 1\n", "row 1 of 'face' has 3 numbers"),
    ("m.ply", PLY + PLY_HEAD + "2 0 1\n", "1 of 1 polygons have fewer than 3"),
    ("m.ply", PLY + PLY_HEAD + "-1 0 1\n", "a list of 'face' has -1 numbers"),
    ("m.ply", PLY + PLY_HEAD + "3 0 1 0.5\n", "refers to vertex 0.5"),
    ("m.ply", PLY + PLY_HEAD + "3 0 1 3\n", "refers to vertex 3"),
    (
        "m.ply",
        PLY + PLY_FACE + PLY_FACE + "end_header\n" + PLY_ROWS + "3 0 1 2\n",
        "needed vertex and face, each once",
    ),
    ("m.ply", PLY.replace("float z", "float w") + PLY_FACE + "end_header\n" + PLY_ROWS, "vertices have no z"),
    ("m.ply", PLY + "elment face 1\nend_header\n" + PLY_ROWS, "'elment face 1' is not PLY"),
    ("m.stl", BINARY + BINARY, "284 bytes follow the 4 triangles of its header, enough for 5 more"),
    ("m.stl", BINARY[:80] + struct.pack("<I", 2) + BINARY[84:], "100 bytes follow the 2 triangles"),
    ("m.stl", BINARY[:-1], "its 4 triangles need 284"),
    (
        "m.stl",
        f"solid a\n{FOUR_CORNERS}endsolid\n",
        "line 7 is 'vertex 1 1 1'; needed endloop: a facet has three vertices",
    ),
    (
        "m.stl",
        f"solid a\n{FACET.replace('vertex 0 0 0', '')}endsolid\n",
        "line 7 is 'endloop'; needed vertex",
    ),
    (
        "m.stl",
        f"solid a\n{FACET}triangle 1 2 3\nendsolid\n",
        "line 9 is 'triangle 1 2 3'; needed facet or end",
    ),
    ("m.stl", f"solid a\n{FACET}endsolid\n{FACET}", "line 10 is 'facet normal 0 0 0'; needed solid"),
    ("m.stl", f"solid a\n{FACET}", "no proper end; the file is truncated"),
    ("m.stl", f"solid a\n{FACET.replace('1 0 0', '1 0')}endsolid\n", "line 5 is a vertex of 2 numbers"),
    ("m.stl", f"solid a\n{FACET.replace('1 0 0', 'inf 0 0')}endsolid\n", "not finite"),
    ("m.vtp", vtp_file(vtp(CORNERS, POLYS, stated='NumberOfPolys="3"')), "NumberOfPolys is 3, 4 offsets"),
    (
        "m.vtp",
        vtp_file(vtp(CORNERS, POLYS, stated='NumberOfPolys="4" NumberOfStrips="36"')),
        "states 36 Strips and lacks their connectivity",
    ),
    (
        "m.vtp",
        vtp_file(vtp(CORNERS, POLYS | {"Strips": [[0, 1, 2]]}, stated='NumberOfPolys="4"')),
        "NumberOfStrips is None, 1 offsets",
    ),
    ("m.vtp", vtp_file(vtp(CORNERS, POLYS, "<Cells/>")), "its Piece holds the unsupported 'Cells'"),
    ("m.vtp", vtp_file(vtp(CORNERS, POLYS, "<Polys/>")), "one of its parts twice"),
    ("m.vtp", vtp_file(SURFACE, "<Part/>"), "its PolyData holds the unsupported 'Part'"),
    ("m.vtp", vtp_file(vtp(CORNERS, POLYS, GHOSTS)), "1 of 4 cells are hidden or repeated .'vtkGhostType'"),
    ("m.vtp", vtp_file(vtp(CORNERS, POLYS, SHORT)), "cell data 'Cap' have 2 values for 4 cells"),
    ("m.vtp", vtp_file(SURFACE, vtp(CORNERS, POLYS, SHORT.replace("0 1", "0 1 0 0"))), "different cell data"),
    ("m.vtp", vtp_file(vtp(CORNERS, {"Polys": [[0, 1, 4]]}), SURFACE), "a cell refers to vertex 4"),
    ("m.vtp", vtp_file(SURFACE, vtp(CORNERS, {"Polys": [[0, 1, -1]]})), "a cell refers to vertex -1"),
    ("m.vtp", vtp_file(vtp(CORNERS, {"Polys": [[0, 1, 2], [0, 1]]})), "1 of 2 polygons have fewer than 3"),
    ("m.vtp", vtp_file(vtp(CORNERS, {"Strips": [[0, 1]]})), "1 of 1 triangle strips have fewer than 3"),
    ("m.vtp", vtp_file(SURFACE.replace(">0 2 1", ">0 2.5 1")), "numbers that are not whole"),
    ("m.vtp", vtp_file(SURFACE.replace(">0.0 0.0", ">nan 0.0")), "not finite"),
]


@pytest.mark.parametrize(
    ("name", "data", "message"), REFUSED, ids=[f"{n[2:]} {i}" for i, (n, *_) in enumerate(REFUSED)]
)
def test_what_may_hold_surface_is_refused(tmp_path: Path, name: str, data: str | bytes, message: str) -> None:
    (tmp_path / name).write_bytes(data.encode() if isinstance(data, str) else data)
    with pytest.raises(UnreadableFileError, match=message) as refused:
        read_mesh(tmp_path / name)
    assert str(refused.value).startswith(str(tmp_path / name))


def test_binary_elements_after_faces_are_refused_and_counts_below_zero(tmp_path: Path) -> None:
    path = tmp_path / "m.ply"
    write_mesh(Mesh("mr", CORNERS, FACES), path)
    whole = path.read_bytes()
    path.write_bytes(whole + whole[-13:])
    with pytest.raises(UnreadableFileError, match="13 bytes follow the elements of its header"):
        read_mesh(path)
    path.write_bytes(whole.replace(b"list uchar", b"list char").replace(b"\x03\0\0\0\0", b"\xff\0\0\0\0", 1))
    with pytest.raises(UnreadableFileError, match="a list of 'face' has -1 numbers"):
        read_mesh(path)


@pytest.mark.parametrize(
    "text",
    [
        "\ufeffv 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\n" + FAN,  # byte-order mark before the first vertex
        VERTICES.replace("v ", "v\t") + FAN.replace("f ", "\tf  "),
        VERTICES + FAN.replace("f 1 3 2", "f 1 3 \\\n 2"),
        "# made in C:\\meshes\\\n" + VERTICES + "usemtl C:\\skin\\\n" + FAN,
        (VERTICES + FAN).replace("\n", "\r"),
    ],
)
def test_no_line_of_an_obj_is_missed(tmp_path: Path, text: str) -> None:
    (tmp_path / "m.obj").write_bytes(text.encode())
    mesh = read_mesh(tmp_path / "m.obj")
    np.testing.assert_array_equal(mesh.vertices_mm, CORNERS)
    np.testing.assert_array_equal(mesh.triangles, FACES)


def ascii_stl(faces: IntArray, name: str = "") -> str:
    lines = [f"solid {name}"]
    for corners in CORNERS[faces].tolist():
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x} {y} {z}" for x, y, z in corners]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid", ""])


@pytest.mark.parametrize(
    "text",
    [
        ascii_stl(FACES).upper(),
        ascii_stl(FACES[:1], "a") + ascii_stl(FACES[1:], "b"),
        ascii_stl(FACES, "Schr\u00e4g \u00c5").replace("\n", "\r\n"),
    ],
)
def test_ascii_stl_in_capitals_in_solids_and_with_any_name(tmp_path: Path, text: str) -> None:
    (tmp_path / "m.stl").write_bytes(text.encode())
    mesh = read_mesh(tmp_path / "m.stl")
    np.testing.assert_array_equal(mesh.vertices_mm[mesh.triangles], CORNERS[FACES])


def test_a_binary_stl_that_begins_as_a_text(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    data = b"solid heart".ljust(80) + BINARY[80:] + b"\r\n"
    (tmp_path / "m.stl").write_bytes(data)
    mesh = read_mesh(tmp_path / "m.stl")
    np.testing.assert_array_equal(mesh.vertices_mm[mesh.triangles], CORNERS[FACES])
    assert "2 bytes after the 4 triangles" in caplog.text


def test_an_ascii_stl_with_damaged_bytes_is_not_called_binary(tmp_path: Path) -> None:
    (tmp_path / "m.stl").write_bytes(ascii_stl(FACES).encode() + bytes(40))
    with pytest.raises(UnreadableFileError, match=r"line 31 is '\\x00"):
        read_mesh(tmp_path / "m.stl")


def series(phases: int = 3) -> SurfaceSeries:
    timing = CycleTiming.uniform(phases, 0.9)
    stack = np.stack([CORNERS + i for i in range(phases)])
    return SurfaceSeries("EPICARDIAL", "mr", stack, FACES, timing, "unknown")


def test_files_that_macos_adds_are_passed_over(tmp_path: Path) -> None:
    for i in range(2):
        write_mesh(Mesh("mr", CORNERS + i, FACES), tmp_path / f"P7_EPICARDIAL_{i}.stl")
        (tmp_path / f"._P7_EPICARDIAL_{i}.stl").write_bytes(b"\0\5\x16\7\0\2\0\0Mac OS X")
    assert surface_names(tmp_path) == ["P7_EPICARDIAL"]
    back = read_surface_series(tmp_path)
    assert back.patient_id == "P7"
    assert len(back.timing) == 2
    (tmp_path / "packed").mkdir()
    with tarfile.open(tmp_path / "packed" / "x.tar.gz", "w:gz") as tar:
        for path in sorted(tmp_path.glob("*.stl")):
            tar.add(path, path.name)
    assert read_surface_series(tmp_path / "packed").patient_id == "P7"


@pytest.mark.parametrize("ending", ["tar", "tar.gz"])
def test_an_archive_without_its_end_is_refused(tmp_path: Path, ending: str) -> None:
    """A tar that is cut off between two members looks whole to the library: a phase would be missed."""
    write_surface_series(series(), tmp_path / "s")
    folder = tmp_path / "a"
    folder.mkdir()
    path = folder / f"x.{ending}"
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as tar:
        for file in sorted((tmp_path / "s").glob("*.vtp")):
            tar.add(file, file.name)
    packed.seek(0)
    with tarfile.open(fileobj=packed) as tar:
        last = tar.getmembers()[-1].offset

    def write(data: bytes) -> None:
        path.write_bytes(gzip.compress(data) if ending == "tar.gz" else data)

    whole = packed.getvalue()
    write(whole)
    assert len(read_surface_series(folder).timing) == 3
    for cut in (whole[:last], whole[: last + 100], whole[:last] + b"x" * 512):
        write(cut)
        with pytest.raises(UnreadableFileError, match="has no proper end"):
            read_surface_series(folder)
    write(whole + whole)
    with pytest.raises(UnreadableFileError, match="has no proper end"):
        read_surface_series(folder)


def test_links_in_an_archive_and_other_caps_in_a_phase_are_refused(tmp_path: Path) -> None:
    write_surface_series(series(), tmp_path / "s")
    text = (tmp_path / "s" / "EPICARDIAL_001.vtp").read_text()
    flagged = SurfaceSeries(
        "EPICARDIAL",
        "mr",
        series().vertices_mm,
        FACES,
        series().timing,
        "x",
        np.array([True, False, False, False]),
    )
    write_surface_series(flagged, tmp_path / "t")
    (tmp_path / "t" / "EPICARDIAL_001.vtp").write_text(text)
    with pytest.raises(UnreadableFileError, match=r"EPICARDIAL_001\.vtp marks other triangles as caps"):
        read_surface_series(tmp_path / "t")
    (tmp_path / "a").mkdir()
    with tarfile.open(tmp_path / "a" / "x.tar", "w") as tar:
        for file in sorted((tmp_path / "s").glob("*.vtp")):
            tar.add(file, file.name)
        link = tarfile.TarInfo("EPICARDIAL_003.vtp")
        link.type, link.linkname = tarfile.LNKTYPE, "EPICARDIAL_000.vtp"
        tar.addfile(link)
    with pytest.raises(UnreadableFileError, match=r"EPICARDIAL_003\.vtp is a link, not a file"):
        read_surface_series(tmp_path / "a")


def test_comments_that_state_a_space_or_a_unit(tmp_path: Path) -> None:
    body = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    (tmp_path / "a.obj").write_text(f"# Coordinate system: RAS\n# units: mm\n{body}")
    assert read_mesh(tmp_path / "a.obj").vertices_mm.min(axis=0).tolist() == [-10, -10, 0]
    (tmp_path / "a.obj").write_text(f"# units: meters\n{body}")
    with pytest.raises(UnreadableFileError, match="states that it is in meters; needed mm"):
        read_mesh(tmp_path / "a.obj")


@pytest.mark.parametrize(("turned", "way"), [(4, "inwards"), (2, "different ways"), (0, None)])
def test_inspect_says_which_way_a_surface_faces(tmp_path: Path, turned: int, way: str | None) -> None:
    faces = np.vstack([FACES[:turned, ::-1], FACES[turned:]])
    write_mesh(Mesh("mr", CORNERS, faces), tmp_path / "a.ply")
    facts = describe(str(tmp_path / "a.ply")).facts
    assert facts["orientation"] == (way and f"its triangles face {way}; a model turns them")
    assert facts["volume_ml"] == (None if turned == 2 else pytest.approx(1 / 6))
