"""Read points for evaluation: a table of x, y, z, or a list of points from 3D Slicer."""

import csv
from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.core.space.points import Points

from . import limits
from .landmarks import LANDMARK_ENDINGS, named_points
from .reading import read_text, reading


def read_points(path: Path | str, frame: str) -> Points:
    """Read points, LPS, mm; names are ignored and may repeat.

    Args:
        path: CSV with x, y, z in LPS, whose first row may be a header; or `.mrk.json`, `.fcsv` or a `.tag`
            of one volume, which state LPS or RAS.
        frame: name of the frame that the points are given in.
    Raises:
        UnreadableFileError: absent, empty, or a row that is not three numbers.
    """
    path = Path(path)
    slicer = path.name.lower().endswith(LANDMARK_ENDINGS)
    with reading(path, "points"):
        xyz_mm = named_points(path)[1] if slicer else _from_csv(path)
        limits.require_lengths(xyz_mm, "a point")
    if not len(xyz_mm):
        raise UnreadableFileError(f"{path} holds no points; needed x, y, z in mm of at least one")
    return Points(frame, xyz_mm)


def _from_csv(path: Path) -> FloatArray:
    rows: list[list[float]] = []
    try:
        table = list(csv.reader(read_text(path, "points").splitlines()))
    except csv.Error as exc:
        raise UnreadableFileError(f"{path} is not a table of points ({exc})") from exc
    for number, row in enumerate(table, start=1):
        if not row:
            continue
        try:
            values = [float(cell) for cell in row]
        except ValueError as exc:
            if number == 1:
                continue
            raise UnreadableFileError(f"{path}, line {number}: '{','.join(row)}' is not x,y,z in mm") from exc
        if len(values) != 3:
            raise UnreadableFileError(f"{path}, line {number}: {len(values)} columns; needed x,y,z in mm")
        rows.append(values)
    return np.array(rows).reshape(-1, 3)
