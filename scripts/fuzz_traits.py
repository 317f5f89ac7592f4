"""Traits that people reported of their own tables, points, recordings and calibrations, put into valid files.

A reader must give the same values, refuse, or warn: another value without a word is a finding.
"""

import dataclasses
import json
import logging
import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig import io
from dvf_ig.core import PoseStream, TrackedSequence
from dvf_ig.core.errors import DvfIgError

Trait = Callable[[str, random.Random], str]
Read = Callable[[Path], Any]


def _rows(change: Callable[[list[list[str]], random.Random], None], mark: str = ",") -> Trait:
    """Change the cells of a table with a row of names."""

    def trait(text: str, rng: random.Random) -> str:
        head, *rows = [line.split(mark) for line in text.splitlines()]
        change(rows, rng)
        return "\n".join(mark.join(row) for row in [head, *rows]) + "\n"

    return trait


def _drop(rows: list[list[str]], rng: random.Random) -> None:
    row = rng.choice(rows)
    del row[rng.randrange(len(row))]


def _cell(*values: str) -> Trait:
    """Put a value into any cell but that of the time or frame."""

    def change(rows: list[list[str]], rng: random.Random) -> None:
        row = rng.choice(rows)
        row[rng.randrange(1, len(row))] = rng.choice(values)

    return _rows(change)


def _scaled(columns: slice, *factors: float) -> Trait:
    def change(rows: list[list[str]], rng: random.Random) -> None:
        factor = rng.choice(factors)
        for row in rows:
            row[columns] = [repr(float(cell) * factor) for cell in row[columns]]

    return _rows(change)


def _swapped(text: str, rng: random.Random) -> str:
    """Exchange two columns, names and values."""
    rows = [line.split(",") for line in text.splitlines()]
    i, j = rng.sample(range(len(rows[0])), 2)
    for row in rows:
        row[i], row[j] = row[j], row[i]
    return "\n".join(map(",".join, rows)) + "\n"


def _continental(text: str, rng: random.Random) -> str:
    mark = rng.choice(";\t")
    return text.replace(",", mark).replace(".", ",")


def _named_unit(text: str, rng: random.Random) -> str:
    """State a unit in the names of x, y and z, with values in it or in one that is not known."""
    unit, factor = rng.choice((("m", 1e-3), ("cm", 0.1), ("inch", 1 / 25.4)))
    scaled = _scaled(slice(1, 4), factor)(text, rng)
    return (
        re.sub(r"\b([xyz])\b", rf"\1 [{unit}]", scaled.splitlines()[0]) + scaled[len(text.splitlines()[0]) :]
    )


def _renamed(text: str, rng: random.Random) -> str:
    head, rest = text.split("\n", 1)
    names = head.split(",")
    names[rng.randrange(len(names))] = rng.choice(("x", "foo", "qz", ""))
    return ",".join(names) + "\n" + rest


def _sub(pattern: str, *texts: str) -> Trait:
    """Replace one match of a pattern."""

    def trait(text: str, rng: random.Random) -> str:
        matches = list(re.finditer(pattern, text, re.MULTILINE))
        if not matches:
            return text
        match = rng.choice(matches)
        return text[: match.start()] + match.expand(rng.choice(texts)) + text[match.end() :]

    return trait


def _every(pattern: str, factor: float) -> Trait:
    """Multiply every number that group 1 of a pattern finds."""

    def times(match: re.Match[str]) -> str:
        mark = "," if "," in match[1] else " "
        numbers = mark.join(repr(float(number) * factor) for number in match[1].replace(mark, " ").split())
        return match[0].replace(match[1], numbers)

    return lambda text, rng: re.sub(pattern, times, text, flags=re.MULTILINE)


def _json(change: Callable[[dict[str, Any], random.Random], None]) -> Trait:
    def trait(text: str, rng: random.Random) -> str:
        document = json.loads(text)
        change(document, rng)
        return json.dumps(document)

    return trait


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
_TABLE = (_rows(_drop), _cell("", "nan", "lost", "1,2", "1e400"), _swapped, _continental, _renamed)
_STATUSES = ("undefined", "preview", "missing", "lost")
TRAITS: dict[str, tuple[str, Read, tuple[Trait, ...]]] = {
    "poses": (
        "poses.csv",
        io.read_poses,
        (*_TABLE, _scaled(slice(1, 4), *_UNITS), _scaled(slice(0, 1), 1e3, 1e9), _named_unit),
    ),
    "points": ("points.csv", lambda p: io.read_points(p, "mr"), (*_TABLE, _scaled(slice(0, 3), 1e-3, 1e3))),
    "features": (
        "features.csv",
        io.read_feature_points,
        (*_TABLE[:4], _sub("^([0-9]+),", "0,", "99999999,")),
    ),
    "markups": (
        "points.mrk.json",
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
    "fcsv": (
        "points.fcsv",
        lambda p: io.read_landmarks(p, "mr"),
        (
            _sub(r",2,0$", ",0,0", ",1,0", ",3,0", ",9,0"),
            _sub(r"^# CoordinateSystem = LPS\n", "", "# CoordinateSystem = 2\n"),
            _sub(r"^(\d),[^,]*,", r"\1,,", r"\1,x,"),
            _every(r"^\d,([-\d.]+,[-\d.]+,[-\d.]+)", 1e-3),
            _every(r"^\d,([-\d.]+,[-\d.]+,[-\d.]+)", 1e3),
        ),
    ),
    "sequence": (
        "sequence.igs.mha",
        _tracked,
        (
            _gap,
            _every(r"Timestamp = (.*)$", 1e3),
            _every(r"^Seq_Frame\d+_Timestamp = (.*)$", 1e6),
            _sub(r"(Seq_Frame\d+_Timestamp = )(.*)$", r"\1\g<2>\n\g<1>9.5"),
            _sub(
                r"UltrasoundImageOrientation = MF",
                *(f"UltrasoundImageOrientation = {o}" for o in ("UF", "MN", "FM")),
            ),
            _sub(r"UltrasoundImageOrientation = MF", "UltrasoundImageOrientation = AMF"),
            _sub(
                r"DimSize = (\d+) (\d+) (\d+)",
                r"DimSize = \1 \2 11",
                r"DimSize = 3 \2 \3",
                r"DimSize = \2 \1 13",
            ),
            _sub("ElementType", "HeaderSize = 4\nElementType", "DimSize = 1 1 1\nElementType"),
            _every(r"ToTrackerTransform = (.*) 0 0 0 1$", 1e-3),
        ),
    ),
    "image-map": (
        "probe.xml",
        io.read_image_map,
        (
            _every(r'Matrix="([^"]*) 0 0 0 1"', 1e-3),
            _every(r'Matrix="([^"]*) 0 0 0 1"', 50.0),
            _sub(
                "</Coord",
                '<Transform From="Image" To="Probe" Matrix="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></Coord',
            ),
            _sub(
                "</Coord",
                '<Transform From="Image" To="Head" Matrix=".1 0 0 0 0 .1 0 0 0 0 1 0 0 0 0 1"/>'
                '<Transform From="Head" To="Probe" Matrix="1 0 0 9 0 1 0 0 0 0 1 0 0 0 0 1"/></Coord',
            ),
        ),
    ),
    "probe": (
        "probe.json",
        lambda p: io.read_probe(p, turned_from="UFA"),
        (_field(image_orientation=("UF", "MN", None, "FM"), sensor_frame=("stylus",), kind=("tip",)),),
    ),
    "tip": ("tip.json", io.read_tip, (_field(tip_mm=([0.001, 0.002, 0.15], [0, 0, 1.5e5], [1, 2], None)),)),
    "lag": ("lag.json", io.read_lag, (_field(lag_s=(21.7, -30.0, 500, None)),)),
    "wire-points": (
        "wires.xml",
        _wires,
        (
            _sub(r'Index="\d+"', 'Index="1"'),
            _sub(r'WireName="[^"]*"', 'WireName="other"'),
            _sub(r"(<Point [^>]*/>)", r"\1\1"),
        ),
    ),
}
"""A valid file, its reader, and what may be wrong with it, by reader."""


def write_trait_seeds(folder: Path) -> None:
    """Write the valid files."""
    from tests.io.conftest import make_nwire

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


class _Warnings(logging.Handler):
    """Count of warnings."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.count = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.count += 1


def _close(one: Any, other: Any) -> bool:
    """Return whether all fields of two values are equal but for rounding."""
    if dataclasses.is_dataclass(one) and not isinstance(one, type):
        return all(_close(getattr(one, f.name), getattr(other, f.name)) for f in dataclasses.fields(one))
    if isinstance(one, np.ndarray):
        return one.shape == other.shape and np.allclose(one, other, rtol=1e-9, atol=1e-12, equal_nan=True)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(_close(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(_close, one, other))
    return bool(one == other)


def silent_traits(reader: str, seed: int, count: int, folder: Path) -> tuple[list[str], int]:
    """Read `count` files with a trait; list those read as other values, and count the changed files."""
    name, read, traits = TRAITS[reader]
    path, warnings, silent, changed = folder / name, _Warnings(), list[str](), 0
    whole = path.read_text(encoding="latin-1")
    true = read(path)
    logging.getLogger("dvf_ig").addHandler(warnings)
    try:
        for number in range(count):
            rng = random.Random(f"trait {seed} {reader} {number}")
            which = rng.randrange(len(traits))
            text = traits[which](whole, rng)
            changed += text != whole
            path.write_text(text, encoding="latin-1")
            before = warnings.count
            try:
                value = read(path)
            except DvfIgError:
                continue
            if warnings.count == before and not _close(value, true):
                silent.append(f"{reader} {number}: trait {which} is read as other values")
    finally:
        path.write_text(whole, encoding="latin-1")
        logging.getLogger("dvf_ig").removeHandler(warnings)
    return silent, changed
