"""Read and write landmarks in LPS: 3D Slicer markups (`.mrk.json`, `.fcsv`) and MNI `.tag` files."""

import csv
import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, Landmarks, OutputError, Points, UnreadableFileError
from dvf_ig.core.plausible import spread_problem

from . import limits
from .json_file import read_json, write_json
from .reading import read_text, reading

log = logging.getLogger(__name__)

_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)
_TO_LPS = {"LPS": (1.0, 1.0, 1.0), "1": (1.0, 1.0, 1.0), "RAS": (-1.0, -1.0, 1.0), "0": (-1.0, -1.0, 1.0)}
_POINTS = ("Fiducial",)
_NOT_PLACED = ("undefined", "preview", "missing")
_FCSV_STATUS = {"": "defined", "0": "undefined", "1": "preview", "2": "defined", "3": "missing"}
"""Numbers of vtkMRMLMarkupsNode's PositionUndefined, PositionPreview, PositionDefined, PositionMissing."""
CURVES = ("Curve", "ClosedCurve", "Line", "Fiducial")
_OF_A_POINT = {
    *("id", "label", "description", "associatedNodeID", "position", "orientation", "selected", "locked"),
    *("visibility", "positionStatus"),
}
_OF_A_MARKUP = {
    *(
        "type",
        "name",
        "coordinateSystem",
        "coordinateUnits",
        "locked",
        "fixedNumberOfControlPoints",
        "display",
    ),
    *("labelFormat", "lastUsedControlPointNumber", "controlPoints", "measurements"),
}
"""Fields of Slicer's schema that are read, or do not move a point."""
LANDMARK_ENDINGS = (".json", ".fcsv", ".tag")
_MODALITY = re.compile(r"(?<![A-Z])(?:(?P<MR>MRI?|CT)|(?P<US>US|(?i:ultrasound)))(?![A-Za-z])")
_TAG_NAMES = ("Volumes", "Points")
_TAG_COMMENT = re.compile(r'("[^"\n]*")|%[^\n]*')
_TAG_STATEMENT = re.compile(r'(\w+)\s*=((?:"[^"\n]*"|[^";])*);')
_TAG_ROW = re.compile(r'((?:[-+\d.eE]+\s+)*[-+\d.eE]+)\s*(?:"([^"]*)")?')


_OF_FCSV = ("CoordinateSystem", "columns", "coordinateUnits")
"""Header fields of a fiducial list, except its version."""


def read_landmarks(path: Path | str, frame: str) -> Landmarks:
    """Read named points; coordinates stored as RAS are converted to LPS.

    Args:
        path: `.mrk.json`, `.fcsv` (both name their coordinate system), or a `.tag` with one volume.
        frame: name of the frame that the points are given in.
    Points that were not placed are left out and named in a logged warning, as is content that is not known.

    Raises:
        UnreadableFileError: absent, another format, no points, repeated names, no coordinate system, other
            units than mm, or markups that are no points (curve, plane, ROI).
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
        _require_mm(xyz)
        return names, xyz


def _require_mm(xyz: FloatArray) -> None:
    """Raise InvalidInputError if points cannot be landmarks in mm."""
    limits.require_lengths(xyz, "a point")
    if problem := spread_problem(xyz):
        raise InvalidInputError(f"its points: the set {problem}")


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
        for side in sides:
            _require_mm(side)
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


def is_markups(path: Path) -> bool:
    """Return whether a JSON file holds 3D Slicer markups."""
    document = read_json(path, "a JSON file")
    return isinstance(document, dict) and "markups" in document


def markup_points(path: Path, kinds: tuple[str, ...] = _POINTS) -> tuple[list[str], FloatArray]:
    """Read names, which may repeat, and (n, 3) LPS positions of every placed point of 3D Slicer markups.

    Args:
        kinds: types of markups that are read.
    Raises:
        UnreadableFileError: not markups, other types or units, or a position that is not three numbers.
    """
    try:
        markups = read_json(path, "3D Slicer markups")["markups"]
        marks, unknown = _Marks(), set[str]()
        for markup in markups:
            kind, units = markup.get("type", "Fiducial"), markup.get("coordinateUnits", "mm")
            if kind not in kinds:
                raise UnreadableFileError(f"{path} holds a markup '{kind}'; needed {' or '.join(kinds)}")
            if units not in ("mm", ["mm", "UCUM", "millimeter"]):
                raise UnreadableFileError(f"{path}: its units are {units}; needed mm: save it again in mm")
            signs = _to_lps(path, markup.get("coordinateSystem", "LPS"))
            for point in markup["controlPoints"]:
                name = str(point.get("label") or point.get("id") or len(marks.names) + 1).strip()
                unknown |= set(point) - _OF_A_POINT
                seen = point.get("visibility", True) is True and point.get("selected", True) is True
                if marks.is_placed(name, point.get("positionStatus", "defined"), is_shown=seen):
                    marks.add(name, np.array(point["position"], dtype=np.float64) * signs)
            unknown |= set(markup) - _OF_A_MARKUP
        marks.warn(path)
        if unknown:
            log.warning("%s: the fields %s are not known and are ignored", path, ", ".join(sorted(unknown)))
        return marks.names, np.array(marks.rows).reshape(-1, 3)
    except (KeyError, TypeError, AttributeError, OverflowError) as exc:
        raise UnreadableFileError(f"{path} is not a 3D Slicer markups file (no {exc})") from exc
    except ValueError as exc:
        if isinstance(exc, UnreadableFileError):
            raise
        raise UnreadableFileError(f"{path}: a position is not three numbers ({exc})") from exc


def _from_fcsv(path: Path) -> tuple[list[str], FloatArray]:
    lines = [_of_spreadsheet(line) for line in read_text(path, "3D Slicer fiducials").splitlines()]
    header = [line[1:].split("=", 1) for line in lines if line.startswith("#") and "=" in line]
    stated = [(key.strip(), value.strip()) for key, value in header]
    fields = dict(stated)
    for key in ("CoordinateSystem", "columns"):
        if len({value for other, value in stated if other == key}) > 1:
            raise UnreadableFileError(f"{path} states {key} twice; delete the line that is wrong")
    if (unit := fields.get("coordinateUnits", "mm")) != "mm":
        raise UnreadableFileError(f"{path}: its units are {unit}; needed mm: save it again in mm")
    if unknown := [key for key in fields if key not in _OF_FCSV and not key.startswith("Markups")]:
        log.warning("%s: the fields %s are not known and are ignored", path, ", ".join(unknown))
    if "CoordinateSystem" not in fields:
        raise UnreadableFileError(
            f"{path} names no CoordinateSystem; needed '# CoordinateSystem = LPS' or RAS"
        )
    signs = _to_lps(path, fields["CoordinateSystem"])
    columns = fields.get("columns", "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label").split(",")
    try:
        at, label = [columns.index(axis) for axis in "xyz"], columns.index("label")
        status, shown = _status_column(columns), [columns.index(c) for c in ("vis", "sel") if c in columns]
        marks = _Marks()
        for row in csv.reader(line for line in lines if line.strip() and not line.startswith("#")):
            if len(row) == 1 and ";" in row[0]:
                raise UnreadableFileError(
                    f"{path}: its cells are separated by semicolons, as a spreadsheet saves them; needed "
                    "commas"
                )
            name = (row[label] if label < len(row) and row[label] else row[0]).strip()
            state = row[status] if status < len(row) else ""
            seen = all(float(row[i]) != 0 for i in shown if i < len(row) and row[i])
            if marks.is_placed(name, _FCSV_STATUS.get(state.strip(), state), is_shown=seen):
                marks.add(name, np.array([float(row[i]) for i in at]) * signs)
    except (ValueError, IndexError, csv.Error) as exc:
        if isinstance(exc, UnreadableFileError):
            raise
        raise UnreadableFileError(f"{path} is not a 3D Slicer fiducial list ({exc})") from exc
    marks.warn(path)
    return marks.names, np.array(marks.rows).reshape(-1, 3)


def _of_spreadsheet(line: str) -> str:
    """Return a header line without the quotes and empty cells that a spreadsheet adds to it."""
    plain = line.strip('"')
    return plain.rstrip(",; ") if plain.startswith("#") else line


def _status_column(columns: list[str]) -> int:
    """Return the column of a point's status, which 3D Slicer writes after those that it names."""
    return columns.index("positionStatus") if "positionStatus" in columns else len(columns)


@dataclass(slots=True)
class _Marks:
    """Placed points of a file of 3D Slicer, and what else it says of its points."""

    names: list[str] = field(default_factory=list)
    rows: list[FloatArray] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    hidden: list[str] = field(default_factory=list)

    def is_placed(self, name: str, status: str, *, is_shown: bool) -> bool:
        """Return whether a point has a position; note one that has none, or that Slicer does not show."""
        if status not in ("defined", *_NOT_PLACED):
            raise ValueError(
                f"the status of '{name}' is '{status}'; needed defined, {', '.join(_NOT_PLACED)}"
            )
        (self.left_out if status in _NOT_PLACED else self.hidden if not is_shown else []).append(name)
        return status == "defined"

    def add(self, name: str, xyz: FloatArray) -> None:
        self.names.append(name)
        self.rows.append(xyz)

    def warn(self, path: Path) -> None:
        """Log the points that are left out or may be unintended."""
        origin = [name for name, xyz in zip(self.names, self.rows, strict=True) if not xyz.any()]
        for names, what in (
            (self.left_out, "not placed in 3D Slicer and left out"),
            (self.hidden, "hidden or not selected in 3D Slicer, and used"),
            (origin, "exactly at 0, 0, 0, and used: check that they were placed"),
        ):
            if names:
                log.warning("%s: points %s are %s", path, ", ".join(names), what)


def _from_tag(path: Path) -> tuple[list[str], list[FloatArray]]:
    """Read names and one (n, 3) LPS array per volume.

    Logs names that repeat, points at exactly 0, 0, 0, and weights that differ, which are not used.
    """
    stated = _tag_statements(path, read_text(path, "an MNI tag file"))
    if stated["Volumes"].strip() not in ("1", "2"):
        raise UnreadableFileError(f"{path}: {stated['Volumes'].strip()[:20]} volumes; needed 1 or 2")
    count = int(stated["Volumes"])
    names: list[str] = []
    rows: list[list[float]] = []
    weights: set[float] = set()
    for line in filter(None, map(str.strip, stated["Points"].splitlines())):
        row = _TAG_ROW.fullmatch(line)
        if row is None:
            raise UnreadableFileError(f"{path}: '{line[:60]}' is not a row of numbers and a name in quotes")
        xyz, more = _tag_numbers(path, row[1], 3 * count)
        rows.append(xyz)
        names.append(row[2] or str(len(rows)))
        weights.update(more[:1])
    if len(weights) > 1:
        log.warning("%s: its points have different weights, which are not used", path)
    if len(set(names)) < len(names):
        repeated = sorted({name for name in names if names.count(name) > 1})
        log.warning("%s: the name %s repeats, so that its points are numbered", path, ", ".join(repeated))
        names = [str(i + 1) for i in range(len(rows))]
    table = np.array(rows, dtype=np.float64).reshape(-1, count, 3)
    _Marks(names, [row[np.abs(row).max(axis=1).argmin()] for row in table]).warn(path)
    table = table * _TO_LPS["RAS"]
    return names, [table[:, side] for side in range(count)]


def _tag_statements(path: Path, text: str) -> dict[str, str]:
    """Parse the statements `Name = content;`, without comments; semicolons in quotes end none."""
    first, _, rest = text.lstrip().partition("\n")
    body = _TAG_COMMENT.sub(lambda match: match[1] or "", rest)
    stated: dict[str, str] = {}
    end = 0
    for match in _TAG_STATEMENT.finditer(body):
        if body[end : match.start()].strip() or match[1] in stated or match[1] not in _TAG_NAMES:
            raise UnreadableFileError(
                f"{path}: '{(body[end : match.start()].strip() or match[1])[:40]}' is not known, or there "
                f"twice; needed {' and '.join(_TAG_NAMES)} once each, each ended by ';'"
            )
        stated[match[1]], end = match[2], match.end()
    if not first.startswith("MNI Tag Point File") or len(stated) < len(_TAG_NAMES) or body[end:].strip():
        raise UnreadableFileError(
            f"{path} is not an MNI tag file, or goes on after its end; needed Volumes and Points, each ended "
            "by ';'"
        )
    return stated


def _tag_numbers(path: Path, text: str, count: int) -> tuple[list[float], list[float]]:
    """Parse the coordinates of a row, and what follows: nothing, or weight, structure and patient."""
    try:
        numbers = [float(number) for number in text.split()]
    except ValueError as exc:
        raise UnreadableFileError(f"{path}: '{text.strip()[:60]}' is not a row of numbers ({exc})") from exc
    more = numbers[count:]
    if len(numbers) < count or len(more) not in (0, 3) or any(one % 1 for one in more[1:]):
        raise UnreadableFileError(
            f"{path}: '{text.strip()[:60]}' has {len(numbers)} numbers; needed {count} for {count // 3} "
            "volumes, with 3 coordinates each, or these and weight, structure and patient: correct Volumes"
        )
    return numbers[:count], more
