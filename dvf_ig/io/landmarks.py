"""Read and write landmarks in LPS: 3D Slicer markups (`.mrk.json`, `.fcsv`) and MNI `.tag` files."""

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import OutputError, UnreadableFileError
from dvf_ig.core.space.points import Landmarks, Points

from . import limits
from .json_file import read_json, write_json
from .reading import read_text, reading

_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)
_TO_LPS = {"LPS": (1.0, 1.0, 1.0), "1": (1.0, 1.0, 1.0), "RAS": (-1.0, -1.0, 1.0), "0": (-1.0, -1.0, 1.0)}
LANDMARK_ENDINGS = (".json", ".fcsv", ".tag")
_MODALITY = re.compile(r"(?<![A-Z])(?:(?P<MR>MRI?|CT)|(?P<US>US|(?i:ultrasound)))(?![A-Za-z])")
_TAG_ROW = re.compile(r'((?:[-+\d.eE]+\s+)*[-+\d.eE]+)\s*(?:"([^"]*)")?')


def read_landmarks(path: Path | str, frame: str) -> Landmarks:
    """Read named points; coordinates stored as RAS are converted to LPS.

    Args:
        path: `.mrk.json`, `.fcsv` (both name their coordinate system), or a `.tag` with one volume.
        frame: name of the frame that the points are given in.
    Raises:
        UnreadableFileError: absent, another format, no points, repeated names, or no coordinate system.
    """
    path = Path(path)
    with reading(path, "landmarks"):
        return _landmarks(path, *named_points(path), frame)


def named_points(path: Path) -> tuple[list[str], FloatArray]:
    """Read names, which may repeat, and (n, 3) LPS positions of a file with any of LANDMARK_ENDINGS.

    Raises:
        UnreadableFileError: absent, another format, two volumes, or no coordinate system.
    """
    with reading(path, "landmarks"):
        names, xyz = _points_of(path, path.name.lower())
        limits.require_lengths(xyz, "a point")
        return names, xyz


def _points_of(path: Path, name: str) -> tuple[list[str], FloatArray]:
    if name.endswith(".json"):
        return markup_points(path)
    if name.endswith(".fcsv"):
        return _from_fcsv(path)
    if not name.endswith(".tag"):
        raise UnreadableFileError(f"{path} has no landmark ending; needed .mrk.json, .fcsv or .tag")
    names, sides = _from_tag(path)
    if len(sides) != 1:
        raise UnreadableFileError(f"{path} pairs the points of two volumes; read it as a pair")
    return names, sides[0]


def read_tag_pair(path: Path | str, frame_first: str, frame_second: str) -> tuple[Landmarks, Landmarks]:
    """Read an MNI `.tag` file of two volumes: the same points in both, under the same names.

    MNI world coordinates are RAS; both sides are returned in LPS.

    Raises:
        UnreadableFileError: absent, not a tag file, or one volume only.
    """
    path = Path(path)
    with reading(path, "an MNI tag file"):
        names, sides = _from_tag(path)
        if len(sides) != 2:
            raise UnreadableFileError(f"{path} holds one volume's points; needed those of two volumes")
        first, second = sides
        limits.require_lengths(np.concatenate(sides), "a point")
        return _landmarks(path, names, first, frame_first), _landmarks(path, names, second, frame_second)


def modalities_of_tag(path: Path | str) -> tuple[str, ...]:
    """Modalities as the comments of an MNI `.tag` name them, in order: "US", and "MR" for MR or CT."""
    comments = re.findall(r"^%.*$", read_text(Path(path), "an MNI tag file"), re.MULTILINE)
    named = [match.lastgroup or "" for line in comments for match in _MODALITY.finditer(line)]
    return tuple(dict.fromkeys(named))


def write_landmarks(landmarks: Landmarks, path: Path | str) -> None:
    """Write 3D Slicer markups (`.mrk.json`), LPS, mm, with every digit.

    Raises:
        OutputError: another ending, or not writable.
    """
    path = Path(path)
    if not path.name.lower().endswith(".json"):
        raise OutputError(f"cannot write {path}: landmarks are written as .mrk.json; change the ending")
    write_json(path, markup_document(landmarks, "LPS"))


def markup_document(
    landmarks: Landmarks, system: Literal["LPS", "RAS"], descriptions: Sequence[str] = ()
) -> dict[str, Any]:
    """Build 3D Slicer markups as a JSON object.

    Args:
        system: coordinate system that the file states; the numbers are written unchanged.
        descriptions: one per point, or none.
    """
    texts = tuple(descriptions) or ("",) * len(landmarks.names)
    rows = zip(landmarks.names, texts, landmarks.points.xyz_mm.tolist(), strict=True)
    points = [
        {
            "id": str(i + 1),
            "label": name,
            "description": description,
            "position": xyz,
            "selected": True,
            "locked": False,
            "visibility": True,
            "positionStatus": "defined",
        }
        for i, (name, description, xyz) in enumerate(rows)
    ]
    markup = {
        "type": "Fiducial",
        "coordinateSystem": system,
        "coordinateUnits": "mm",
        "controlPoints": points,
    }
    return {"@schema": _SCHEMA, "markups": [markup]}


def _landmarks(path: Path, names: list[str], xyz: FloatArray, frame: str) -> Landmarks:
    if not names:
        raise UnreadableFileError(f"{path} holds no points; needed at least one")
    return Landmarks(tuple(names), Points(frame, xyz))


def _to_lps(path: Path, system: Any) -> FloatArray:
    signs = _TO_LPS.get(str(system).strip().upper())
    if signs is None:
        raise UnreadableFileError(f"{path}: coordinate system is '{system}'; needed LPS or RAS")
    return np.array(signs)


def markup_points(path: Path) -> tuple[list[str], FloatArray]:
    """Read names, which may repeat, and (n, 3) LPS positions of every defined point of 3D Slicer markups."""
    try:
        markups = read_json(path, "3D Slicer markups")["markups"]
        names: list[str] = []
        rows: list[FloatArray] = []
        for markup in markups:
            if markup.get("coordinateUnits", "mm") != "mm":
                raise UnreadableFileError(f"{path}: units are '{markup['coordinateUnits']}'; needed mm")
            signs = _to_lps(path, markup.get("coordinateSystem", "LPS"))
            for point in markup["controlPoints"]:
                if point.get("positionStatus", "defined") == "defined":
                    names.append(str(point.get("label") or point.get("id") or len(names) + 1))
                    rows.append(np.array(point["position"], dtype=np.float64) * signs)
        return names, np.array(rows).reshape(-1, 3)
    except (KeyError, TypeError, AttributeError, OverflowError) as exc:
        raise UnreadableFileError(f"{path} is not a 3D Slicer markups file (no {exc})") from exc
    except ValueError as exc:
        if isinstance(exc, UnreadableFileError):
            raise
        raise UnreadableFileError(f"{path}: a position is not three numbers ({exc})") from exc


def _from_fcsv(path: Path) -> tuple[list[str], FloatArray]:
    lines = read_text(path, "3D Slicer fiducials").splitlines()
    header = dict(line[1:].split("=", 1) for line in lines if line.startswith("#") and "=" in line)
    fields = {key.strip(): value.strip() for key, value in header.items()}
    if "CoordinateSystem" not in fields:
        raise UnreadableFileError(
            f"{path} names no CoordinateSystem; needed '# CoordinateSystem = LPS' or RAS"
        )
    signs = _to_lps(path, fields["CoordinateSystem"])
    columns = fields.get("columns", "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label").split(",")
    try:
        at, label = [columns.index(axis) for axis in "xyz"], columns.index("label")
        table = list(csv.reader(line for line in lines if line.strip() and not line.startswith("#")))
        names = [row[label] if label < len(row) and row[label] else row[0] for row in table]
        xyz = np.array([[float(row[i]) for i in at] for row in table]).reshape(-1, 3)
    except (ValueError, IndexError, csv.Error) as exc:
        raise UnreadableFileError(f"{path} is not a 3D Slicer fiducial list ({exc})") from exc
    return names, xyz * signs


def _from_tag(path: Path) -> tuple[list[str], list[FloatArray]]:
    """Read names and one (n, 3) LPS array per volume."""
    text = read_text(path, "an MNI tag file")
    volumes = re.search(r"Volumes\s*=\s*([0-9]{1,3})\s*;", text)
    body = re.search(r"Points\s*=(.*?);", text, re.DOTALL)
    if not text.startswith("MNI Tag Point File") or volumes is None or body is None:
        raise UnreadableFileError(f"{path} is not an MNI tag file (no Volumes and Points)")
    count = int(volumes[1])
    names: list[str] = []
    rows: list[list[float]] = []
    for line in body[1].splitlines():
        row = _TAG_ROW.fullmatch(line.strip())
        if row is None and line.strip() and not line.lstrip().startswith("%"):
            raise UnreadableFileError(f"{path}: '{line.strip()[:60]}' is not a row of numbers and a name")
        if row is not None:
            rows.append(_coordinates(path, row[1], 3 * count))
            names.append(row[2] or str(len(rows)))
    if count not in (1, 2) or any(len(row) != 3 * count for row in rows):
        raise UnreadableFileError(f"{path}: {count} volumes; needed 1 or 2 with 3 coordinates each per row")
    if len(set(names)) < len(names):
        names = [str(i + 1) for i in range(len(rows))]
    table = np.array(rows).reshape(-1, count, 3) * _TO_LPS["RAS"]
    return names, [table[:, side] for side in range(count)]


def _coordinates(path: Path, text: str, count: int) -> list[float]:
    """Parse the first `count` numbers of a row; ignore what follows (weight, structure, patient)."""
    try:
        return [float(number) for number in text.split()[:count]]
    except ValueError as exc:
        raise UnreadableFileError(f"{path}: '{text.strip()[:60]}' is not a row of numbers ({exc})") from exc
