"""Points without names: a table of x, y, z, which is written too, or a list of points from 3D Slicer."""

import logging
import re
from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, Points, UnreadableFileError
from dvf_ig.core.plausible import spread_problem

from . import limits
from .landmarks import LANDMARK_ENDINGS, named_points
from .number_table import read_number_table, scaled
from .reading import reading
from .table_text import MM_IN
from .writing.atomic import write_text

log = logging.getLogger(__name__)

_SPACE = re.compile(r"\b(RAS|LAS|RPI)\b")
_UNIT = re.compile(r"\bunits?\s*[=:]\s*(cm|m|um|(centi|micro)?met(er|re)s?|inch(es)?)\b", re.IGNORECASE)
_AXES = {"x": (0, 1.0), "y": (1, 1.0), "z": (2, 1.0), "l": (0, 1.0), "p": (1, 1.0), "s": (2, 1.0)} | {
    "r": (0, -1.0),
    "a": (1, -1.0),
}
"""Axis in LPS, and its sign, by the name of a column."""


def read_points(path: Path | str, frame: str) -> Points:
    """Read points, LPS, mm; names are ignored and may repeat.

    Args:
        path: table of x, y, z in LPS, whose first row may name the columns in any order, with units ("x_m")
            or as R, A, S; or `.mrk.json`, `.fcsv` or a `.tag` of one volume, which state LPS or RAS.
        frame: name of the frame that the points are given in.
    Raises:
        UnreadableFileError: absent, empty, a row that is not three numbers, or points that cannot be in mm.
    """
    path = Path(path)
    slicer = path.name.lower().endswith(LANDMARK_ENDINGS)
    with reading(path, "points"):
        xyz_mm = named_points(path)[1] if slicer else _from_table(path)
        limits.require_lengths(xyz_mm, "a point")
        if problem := spread_problem(xyz_mm):
            raise InvalidInputError(f"its points: the set {problem}")
    if not len(xyz_mm):
        raise UnreadableFileError(f"{path} holds no points; needed x, y, z in mm of at least one")
    return Points(frame, xyz_mm)


def write_points(points: Points, path: Path | str) -> None:
    """Write a table of x, y, z in LPS, mm, which `read_points` gives back exactly.

    Raises:
        OutputError: the file cannot be written.
    """
    rows = [",".join(map(repr, row)) for row in points.xyz_mm.tolist()]
    write_text(Path(path), "\n".join(["x_mm,y_mm,z_mm", *rows, ""]))


def _from_table(path: Path) -> FloatArray:
    table = read_number_table(path, "points: rows of x, y, z in mm")
    words = " ".join(table.comments)
    if (said := _SPACE.search(words) or _UNIT.search(words)) is not None:
        raise UnreadableFileError(
            f"{path}: a comment says '{said[0].strip()}', and points are read as LPS in mm; name the columns "
            "instead, as in R,A,S or x_m,y_m,z_m"
        )
    names = table.names or ("x", "y", "z")
    at = [i for i, name in enumerate(names) if name in _AXES]
    axes = [_AXES[names[i]] for i in at]
    if len(names) != table.values.shape[1] or sorted(axis for axis, _ in axes) != [0, 1, 2]:
        raise UnreadableFileError(
            f"{path} has {table.values.shape[1]} columns ({', '.join(names)[:60]}); needed x,y,z in mm"
        )
    if other := [name or "without a name" for name in (*names, *table.texts) if name not in _AXES]:
        log.warning("%s: the columns %s are no coordinates and are left out", path, ", ".join(other))
    for line, row in zip(table.lines, table.values[:, at], strict=True):
        if not np.isfinite(row).all():
            raise UnreadableFileError(f"{path}, line {line}: a cell is empty or nan; needed x,y,z in mm")
    stored = scaled(path, table, at, MM_IN) * [sign for _, sign in axes]
    return stored[:, np.argsort([axis for axis, _ in axes])]
