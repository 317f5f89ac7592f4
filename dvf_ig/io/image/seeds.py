"""Read seeds for segmentation: 3D Slicer markups labelled with the region of each point, or plain JSON."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, Points, Seeds, UnreadableFileError
from dvf_ig.core.plausible import spread_problem
from dvf_ig.io import limits
from dvf_ig.io.json_file import read_json
from dvf_ig.io.landmarks import named_points
from dvf_ig.io.reading import reading

KINDS = ("heart", "background", "cavity")


def read_seeds(path: Path | str, frame: str = "mr") -> Seeds:
    """Read seeds, LPS, mm.

    Args:
        path: `.mrk.json` or `.fcsv` with points labelled heart, background or cavity (a name may repeat,
            and a number may follow: "heart-3"), or JSON
            `{"heart": [[x, y, z], …], "background": […], "cavity": […]}` in LPS.
        frame: name of the image's frame.
    Raises:
        UnreadableFileError: absent, another format, an unknown name, or heart or background without points.
    """
    path = Path(path)
    with reading(path, "a file of seeds"):
        points = (
            _of_markups(path) if _is_markups(path) else _of_lists(path, read_json(path, "a file of seeds"))
        )
        for kind, xyz in points.items():
            limits.require_lengths(xyz, f"a seed of '{kind}'")
        if problem := spread_problem(np.concatenate([points[kind] for kind in KINDS])):
            raise InvalidInputError(f"its seeds: the set {problem}")
        heart, background, cavity = (Points(frame, points[kind]) for kind in KINDS)
        return Seeds(heart, background, cavity)


def _is_markups(path: Path) -> bool:
    if path.suffix.lower() == ".fcsv":
        return True
    document = read_json(path, "a file of seeds")
    return isinstance(document, dict) and "markups" in document


def _of_markups(path: Path) -> dict[str, FloatArray]:
    names, xyz = named_points(path)
    rows: dict[str, list[FloatArray]] = {kind: [] for kind in KINDS}
    for name, point in zip(names, xyz, strict=True):
        rows[_kind(path, re.sub(r"[\s_-]*\d*$", "", name))].append(point)
    return {kind: np.array(points).reshape(-1, 3) for kind, points in rows.items()}


def _of_lists(path: Path, document: Any) -> dict[str, FloatArray]:
    if not isinstance(document, dict):
        raise UnreadableFileError(f"{path} is not a file of seeds; needed an object with lists of points")
    seeds = {kind: np.zeros((0, 3)) for kind in KINDS}
    for name, points in document.items():
        try:
            seeds[_kind(path, name)] = np.array(points, dtype=np.float64).reshape(-1, 3)
        except (TypeError, ValueError, OverflowError) as exc:
            if isinstance(exc, UnreadableFileError):
                raise
            raise UnreadableFileError(
                f"{path}: the points of '{name}' are not rows of x, y, z in mm"
            ) from exc
    return seeds


def _kind(path: Path, name: str) -> str:
    kind = name.strip().lower()
    if kind not in KINDS:
        raise UnreadableFileError(f"{path}: a seed is named '{name}'; needed {', '.join(KINDS)}")
    return kind
