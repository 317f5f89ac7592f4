"""Traits of tables, points, meshes, tracked recordings and calibrations."""

import json
import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig import io
from dvf_ig.core import PoseStream, TrackedSequence

from . import Target, Trait, drop_cell, in_cells, in_text, replaced, substituted, swap_columns


def _cell(*values: str) -> Trait:
    """Put a value into any cell but that of the time or frame."""

    def change(rows: list[list[str]], rng: random.Random) -> None:
        row = rng.choice(rows[1:])
        row[rng.randrange(1, len(row))] = rng.choice(values)

    return in_cells(change)


def _scaled(columns: slice, *factors: float) -> Trait:
    """Multiply columns by a factor."""
    return in_cells(lambda rows, rng: _times(rows, columns, rng.choice(factors)))


def _times(rows: list[list[str]], columns: slice, factor: float) -> None:
    for row in rows[1:]:
        row[columns] = [repr(float(cell) * factor) for cell in row[columns]]


def _continental(text: str, rng: random.Random) -> str:
    """Save as a spreadsheet does where the decimal mark is a comma."""
    mark = rng.choice(";\t")
    return text.replace(",", mark).replace(".", ",")


def _named_unit(rows: list[list[str]], rng: random.Random) -> None:
    """State a unit in the names of x, y and z, with values in it or in one that is not known."""
    unit, factor = rng.choice((("m", 1e-3), ("cm", 0.1), ("inch", 1 / 25.4)))
    _times(rows, slice(1, 4), factor)
    rows[0][1:4] = [f"{name} [{unit}]" for name in rows[0][1:4]]


def _renamed(rows: list[list[str]], rng: random.Random) -> None:
    rows[0][rng.randrange(len(rows[0]))] = rng.choice(("x", "foo", "qz", ""))


def _every(pattern: str, factor: float) -> Trait:
    """Multiply every number that group 1 of a pattern finds."""

    def times(match: re.Match[str]) -> str:
        mark = "," if "," in match[1] else " "
        numbers = mark.join(repr(float(number) * factor) for number in match[1].replace(mark, " ").split())
        return match[0].replace(match[1], numbers)

    return in_text(lambda text, rng: re.sub(pattern, times, text, flags=re.MULTILINE))


def _json(change: Callable[[dict[str, Any], random.Random], None]) -> Trait:
    def trait(text: str, rng: random.Random) -> str:
        document = json.loads(text)
        change(document, rng)
        return json.dumps(document)

    return in_text(trait)


def _a_point(**values: tuple[Any, ...]) -> Trait:
    """Give one point of markups another value of a field."""

    def change(document: dict[str, Any], rng: random.Random) -> None:
        name = rng.choice(sorted(values))
        points = document["markups"][0]["controlPoints"]
        rng.choice(points)[name] = rng.choice(values[name])

    return _json(change)


def _markup(**values: tuple[Any, ...]) -> Trait:
    def change(document: dict[str, Any], rng: random.Random) -> None:
        name = rng.choice(sorted(values))
        document["markups"][0][name] = rng.choice(values[name])

    return _json(change)


def _field(**values: tuple[Any, ...]) -> Trait:
    def change(document: dict[str, Any], rng: random.Random) -> None:
        name = rng.choice(sorted(values))
        document[name] = rng.choice(values[name])

    return _json(change)


def _scaled_points(document: dict[str, Any], rng: random.Random) -> None:
    factor = rng.choice((1e-3, 1e3))
    for point in document["markups"][0]["controlPoints"]:
        point["position"] = [factor * v for v in point["position"]]


def _gap(text: str, rng: random.Random) -> str:
    """Drop every field of one frame."""
    return re.sub(rf"^Seq_Frame{rng.randrange(12):04d}_.*\n", "", text, flags=re.MULTILINE)


def _tracked(path: Path) -> Any:
    sequence = io.read_sequence(path)
    return sequence, io.tracked_probe(sequence)


def _wires(path: Path) -> Any:
    from tests.io.conftest import make_nwire

    return io.read_wire_points(path, "CalibrationData", make_nwire(np.random.default_rng(0)).phantom)


_UNITS = (0.001, 1e4)
_TABLE = (
    in_cells(drop_cell),
    _cell("", "nan", "lost", "1,2", "1e400"),
    in_cells(swap_columns),
    in_text(_continental),
    in_cells(_renamed),
)
_STATUSES = ("undefined", "preview", "missing", "lost")
_LAST = r"\1", r"\1 x", r"\1 nan", r"\1 1,5"
_OBJ = (
    substituted(r"^v .*\n", ""),
    substituted(r"^(v \S+ \S+) \S+$", *_LAST),
    substituted(r"^(v .*)$", r"\1 0.5", r"\1 1 0 0"),
    substituted(
        r"^f (\d+) (\d+) (\d+)$", r"f \1 \2", r"f \1 \2 9", r"f 0 \2 \3", r"f \1 \2 \3 \1", r"f \1 \2 \2"
    ),
    substituted(r"^f (\d+) (\d+) (\d+)$", r"f \1//1 \2//1 \3", r"l \1 \2 \3", "curv 0 1 1 2"),
    replaced(("LPS", "SCANNER"), ("# SPACE=LPS", "# SPACE=RAS\n# SPACE=LPS")),
)
_PLY = (
    replaced(
        *(
            (f"{name} {n}", f"{name} {n + step}")
            for name, n in (("vertex", 6), ("face", 8))
            for step in (-1, 1)
        )
    ),
    replaced(
        ("float z", "float w"), ("float z\n", "float z\nproperty float x\n"), ("property float z\n", "")
    ),
    replaced(
        ("vertex_indices", "vertex_ind"), ("uchar int", "uchar float"), ("ascii", "binary_little_endian")
    ),
    replaced(("end_header", "element strips 1\nproperty list int int vertex_indices\nend_header")),
    substituted(
        r"^3 (\d) (\d) (\d)$", r"3 \1 \2", r"2 \1 \2", r"4 \1 \2 \3", r"3 \1 \2 9", r"3 \1 \2 \2", ""
    ),
    substituted(r"^([-\d.]+ [-\d.]+) [-\d.]+$", *_LAST, r"\1 1 2"),
)
_STL = (
    substituted(r"^vertex .*\n", ""),
    substituted(r"^(vertex \S+ \S+) \S+$", *_LAST, r"\1 1 2"),
    substituted(r"^endfacet\n", ""),
    substituted(r"^endloop\n", "", "endloop\nouter loop\n"),
    substituted(r"^facet.*\n", ""),
    substituted(r"^(vertex .*\n)vertex .*\n", r"\1\1"),
    replaced(("endsolid heart\n", ""), ("LPS", "SCANNER")),
)
TRAITS = {
    "poses": Target(
        "geometry/poses.csv",
        io.read_poses,
        (*_TABLE, _scaled(slice(1, 4), *_UNITS), _scaled(slice(0, 1), 1e3, 1e9), in_cells(_named_unit)),
    ),
    "points": Target(
        "geometry/points.csv", lambda p: io.read_points(p, "mr"), (*_TABLE, _scaled(slice(0, 3), 1e-3, 1e3))
    ),
    "features": Target(
        "geometry/features.csv",
        io.read_feature_points,
        (*_TABLE[:4], substituted("^([0-9]+),", "0,", "99999999,")),
    ),
    "markups": Target(
        "geometry/points.mrk.json",
        lambda p: io.read_landmarks(p, "mr"),
        (
            _a_point(positionStatus=_STATUSES, position=([0, 0, 0], [1, 2], None), fog=(1,), label=("apex",)),
            _a_point(visibility=(False,), selected=(False,)),
            _markup(
                coordinateUnits=("m", ["m", "UCUM", "meter"], "um"), coordinateSystem=("IJK", None, "SAR")
            ),
            _markup(type=("ROI", "Plane", "ClosedCurve", "Curve"), offset=([1, 2, 3],)),
            _json(_scaled_points),
        ),
    ),
    "fcsv": Target(
        "geometry/points.fcsv",
        lambda p: io.read_landmarks(p, "mr"),
        (
            substituted(r",2,0$", ",0,0", ",1,0", ",3,0", ",9,0"),
            substituted(r"^# CoordinateSystem = LPS\n", "", "# CoordinateSystem = 2\n"),
            substituted(r"^(\d),[^,]*,", r"\1,,", r"\1,x,"),
            _every(r"^\d,([-\d.]+,[-\d.]+,[-\d.]+)", 1e-3),
            _every(r"^\d,([-\d.]+,[-\d.]+,[-\d.]+)", 1e3),
        ),
    ),
    "tag": Target(
        "geometry/points.tag",
        lambda p: io.read_landmarks(p, "mr"),
        (
            substituted(
                r"^Volumes = 1;", "Volumes = 2;", "Volumes = 1;\nVolumes = 2;", "Volumes = 1;\nUnits = m;"
            ),
            substituted(
                r"^( \S+ \S+ \S+)", r"\1 4.5 5.5 6.5", r"\1 1 2 3 4", r"\1 0.5 1 1", r"\1 9", r"\1,5"
            ),
            substituted(r"^ \S+ \S+ \S+", " 0 0 0", " nan 1 2", " 1 2"),
            substituted(r'"(apex|base)"', '"left"', "left", "'left'", '"a"b"'),
            substituted(r"^Points =", "% by hand; 2024\nPoints =", "Points = 1 2 3;\nPoints ="),
            substituted(r";\Z", "", ";\n1 2 3;", ";\nPoints =\n 1 2 3;"),
            _every(r"^ (\S+ \S+ \S+)", 1e-3),
        ),
    ),
    "sequence": Target(
        "geometry/sequence.igs.mha",
        _tracked,
        (
            in_text(_gap),
            substituted(r"(ToTrackerTransform = ).*$", r"\g<1>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"),
            _every(r"Timestamp = (.*)$", 1e3),
            _every(r"^Seq_Frame\d+_Timestamp = (.*)$", 1e6),
            substituted(r"(Seq_Frame\d+_Timestamp = )(.*)$", r"\1\g<2>\n\g<1>9.5"),
            substituted(
                r"UltrasoundImageOrientation = MF",
                *(f"UltrasoundImageOrientation = {o}" for o in ("UF", "MN", "FM")),
            ),
            substituted(r"UltrasoundImageOrientation = MF", "UltrasoundImageOrientation = AMF"),
            substituted(
                r"DimSize = (\d+) (\d+) (\d+)",
                r"DimSize = \1 \2 11",
                r"DimSize = 3 \2 \3",
                r"DimSize = \2 \1 13",
            ),
            substituted("ElementType", "HeaderSize = 4\nElementType", "DimSize = 1 1 1\nElementType"),
            _every(r"ToTrackerTransform = (.*) 0 0 0 1$", 1e-3),
        ),
    ),
    "mesh-obj": Target("geometry/mesh.obj", io.read_mesh, _OBJ),
    "mesh-ply": Target("geometry/mesh.ply", io.read_mesh, _PLY),
    "mesh-stl": Target("geometry/mesh.stl", io.read_mesh, _STL),
    "image-map": Target(
        "geometry/probe.xml",
        io.read_image_map,
        (
            _every(r'Matrix="([^"]*) 0 0 0 1"', 1e-3),
            _every(r'Matrix="([^"]*) 0 0 0 1"', 50.0),
            substituted(
                "</Coord",
                '<Transform From="Image" To="Probe" Matrix="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></Coord',
            ),
            substituted(
                "</Coord",
                '<Transform From="Image" To="Head" Matrix=".1 0 0 0 0 .1 0 0 0 0 1 0 0 0 0 1"/>'
                '<Transform From="Head" To="Probe" Matrix="1 0 0 9 0 1 0 0 0 0 1 0 0 0 0 1"/></Coord',
            ),
        ),
    ),
    "probe": Target(
        "geometry/probe.json",
        lambda p: io.read_probe(p, turned_from="UFA"),
        (_field(image_orientation=("UF", "MN", None, "FM"), sensor_frame=("stylus",), kind=("tip",)),),
    ),
    "tip": Target(
        "geometry/tip.json",
        io.read_tip,
        (_field(tip_mm=([0.001, 0.002, 0.15], [0, 0, 1.5e5], [1, 2], None)),),
    ),
    "lag": Target("geometry/lag.json", io.read_lag, (_field(lag_s=(21.7, -30.0, 500, None)),)),
    "wire-points": Target(
        "geometry/wires.xml",
        _wires,
        (
            substituted(r'Index="\d+"', 'Index="1"'),
            substituted(r'WireName="[^"]*"', 'WireName="other"'),
            substituted(r"(<Point [^>]*/>)", r"\1\1"),
        ),
    ),
}


def write_seeds(folder: Path) -> None:
    """Write the valid files."""
    from tests.io.conftest import make_nwire

    folder = folder / "geometry"
    folder.mkdir()
    rng = np.random.default_rng(1)
    quaternions = rng.normal(size=(14, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1)[:, None]
    places = np.array([120.0, 30.0, -900.0]) + 20.0 * rng.random((14, 3))
    rows = np.column_stack([0.05 * np.arange(14), places, quaternions]).round(12).tolist()
    lines = ["t,x,y,z,qx,qy,qz,qw", *(",".join(map(repr, row)) for row in rows)]
    (folder / "poses.csv").write_text("\n".join(lines) + "\n")
    xyz = (60.0 * rng.normal(size=(5, 3))).round(3).tolist()
    (folder / "points.csv").write_text("\n".join(["x,y,z", *(",".join(map(repr, p)) for p in xyz)]) + "\n")
    pixels = (100 * rng.random((6, 4))).round(2).tolist()
    head = "frame,column1_px,row1_px,column2_px,row2_px"
    lines = [head, *(",".join(map(repr, [i, *row])) for i, row in enumerate(pixels))]
    (folder / "features.csv").write_text("\n".join(lines) + "\n")
    names = ("apex", "base", "left", "right", "top")
    points = [
        {"label": n, "position": p, "positionStatus": "defined"} for n, p in zip(names, xyz, strict=True)
    ]
    markup = {"type": "Fiducial", "coordinateSystem": "LPS", "coordinateUnits": "mm", "controlPoints": points}
    (folder / "points.mrk.json").write_text(json.dumps({"markups": [markup]}))
    columns = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID"
    placed = [f"{i},{x},{y},{z},0,0,0,1,1,1,0,{names[i]},,,2,0" for i, (x, y, z) in enumerate(xyz)]
    header = ["# CoordinateSystem = LPS", f"# columns = {columns}"]
    (folder / "points.fcsv").write_text("\n".join([*header, *placed]) + "\n")
    rows = "\n".join(f' {x} {y} {z} "{name}"' for name, (x, y, z) in zip(names, xyz, strict=True))
    (folder / "points.tag").write_text(f"MNI Tag Point File\nVolumes = 1;\nPoints =\n{rows};")
    _write_meshes(folder)
    turns = np.tile(np.eye(3), (12, 1, 1))
    stream = PoseStream("tracker", "probe", np.linspace(0.0, 0.55, 12), turns, places[:12], np.ones(12, bool))
    images = rng.integers(1, 127, (12, 2, 2)).astype(np.uint8)
    sequence = TrackedSequence(stream.t_s, images, np.ones(12, bool), {stream.name: stream}, orientation="MF")
    io.write_sequence(sequence, folder / "sequence.igs.mha", compression=0)
    matrix = np.array([[0.1, 0, 0, 1.0], [0, 0.1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    text = " ".join(f"{v:g}" for v in matrix.ravel())
    (folder / "probe.xml").write_text(
        f'<P><CoordinateDefinitions><Transform From="Image" To="Probe" Matrix="{text}"/>'
        "</CoordinateDefinitions></P>"
    )
    verdict = {"refused": False, "refused_because": []}
    probe = {"kind": "probe", "sensor_from_image": matrix, "sensor_frame": "probe", "image_orientation": "MF"}
    io.write_json(folder / "probe.json", {**verdict, **probe})
    io.write_json(folder / "tip.json", {**verdict, "kind": "tip", "tip_mm": [1, 2, 150], "tip_frame": "tool"})
    io.write_json(folder / "lag.json", {**verdict, "kind": "latency", "lag_s": 0.03})
    recording = make_nwire(rng)
    io.write_wire_points(folder / "wires.xml", "CalibrationData", recording.phantom, recording.points_px)


def _write_meshes(folder: Path) -> None:
    """Write an octahedron as text."""
    xyz = [(35, 5, 5), (-25, 5, 5), (5, 35, 5), (5, -25, 5), (5, 5, 35), (5, 5, -25)]
    faces = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    corners = [" ".join(map(str, corner)) for corner in xyz]
    lines = ["# SPACE=LPS", *(f"v {corner}" for corner in corners)]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (folder / "mesh.obj").write_text("\n".join(lines) + "\n")
    head = ["ply", "format ascii 1.0", "comment SPACE=LPS", "element vertex 6"]
    head += [f"property float {axis}" for axis in "xyz"]
    head += ["element face 8", "property list uchar int vertex_indices", "end_header"]
    (folder / "mesh.ply").write_text(
        "\n".join([*head, *corners, *(f"3 {a} {b} {c}" for a, b, c in faces)]) + "\n"
    )
    solid = ["solid heart SPACE=LPS"]
    for face in faces:
        solid += [
            "facet normal 0 0 0",
            "outer loop",
            *(f"vertex {corners[i]}" for i in face),
            "endloop",
            "endfacet",
        ]
    (folder / "mesh.stl").write_text("\n".join([*solid, "endsolid heart"]) + "\n")
