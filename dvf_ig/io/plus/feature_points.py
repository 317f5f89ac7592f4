"""Read segmented points of a calibration target: a table with one row per image."""

from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.core.recordings.sequence import TrackedSequence
from dvf_ig.core.recordings.stream import PoseStream
from dvf_ig.io import limits
from dvf_ig.io.reading import read_text, reading

from .names import USUAL_NAMES, ProbeNames
from .poses import SEQUENCE_SUFFIXES, read_poses
from .sequence_read import read_indexed_sequence

LARGEST_PX = 1e6
"""Largest distance of a segmented point from an image's corner."""


def read_feature_points(path: Path | str, frames: int | None = None) -> FloatArray:
    """Read segmented points of the images of a sequence.

    Args:
        path: text table, with commas or blanks, with the columns frame, column1_px, row1_px, column2_px,
            row2_px, … ; cells are empty or nan if a point was not found. Without a header the columns are the
            same, or, if their number is even, only the points: row i is then frame i.
        frames: images in the sequence; None uses the highest frame number + 1.
    Returns:
        (frames, points, 2) column, row in px; NaN if not found or not listed.
    Raises:
        UnreadableFileError: absent, other columns, a non-numeric cell, a frame listed twice or beyond the
            sequence.
    """
    path = Path(path)
    text = read_text(path, "segmented points")
    lines = [_cells(line) for line in text.splitlines() if line.strip() and line.lstrip()[0] not in "#%"]
    head = _header(path, lines)
    count = (len(head) - 1) // 2
    numbers: list[int] = []
    rows: list[FloatArray] = []
    for number, line in enumerate(lines[1:], start=2):
        frame, *cells = _numbers(path, number, line, len(head))
        if not 0 <= frame < limits.FRAMES or frame != int(frame):
            raise UnreadableFileError(
                f"{path}, line {number}: '{line[0]}' is not a frame number (0, 1, 2, …)"
            )
        numbers.append(int(frame))
        rows.append(np.array(cells).reshape(count, 2))
    total = max(numbers, default=-1) + 1 if frames is None else frames
    if len(set(numbers)) < len(numbers):
        raise UnreadableFileError(f"{path} lists a frame twice; needed one row per image")
    if numbers and max(numbers) >= total:
        raise UnreadableFileError(f"{path} has frame {max(numbers)}, the sequence has {total} images")
    points = np.full((total, count, 2), np.nan)
    for at, row in zip(numbers, rows, strict=True):
        points[at] = row
    return points


def read_target_recording(
    poses_path: Path | str, points_path: Path | str, names: ProbeNames = USUAL_NAMES
) -> tuple[PoseStream, FloatArray]:
    """Read poses of the tracked probe and the target's points, matched frame by frame.

    Args:
        poses_path: PLUS sequence with the probe tracked against the reference sensor or the tracker; or poses
            as text, one row or file per frame (see `read_poses`).
        points_path: see `read_feature_points`; frame numbers count the frames of the poses' file from 0.
        names: of probe and reference in the sequence; poses as text are given these names.
    Returns:
        reference_from_probe if a reference was tracked, else tracker_from_probe, and (n, points, 2) px.
    Raises:
        UnreadableFileError: either cannot be read, or they do not belong together.
    """
    path = Path(poses_path)
    with reading(path, "a sequence with a tracked probe, or its poses as text"):
        if path.suffix.lower() not in SEQUENCE_SUFFIXES:
            poses = read_poses(path, names.reference, names.probe)
            return poses, read_feature_points(points_path, len(poses))
        sequence, indices, frames = read_indexed_sequence(path)
        poses = tracked_probe(sequence, names)
    return poses, read_feature_points(points_path, frames)[indices]


def tracked_probe(sequence: TrackedSequence, names: ProbeNames = USUAL_NAMES) -> PoseStream:
    """Return the probe's pose relative to the reference sensor if one was tracked, else to the tracker.

    Raises:
        InvalidInputError: the sequence does not connect the two frames.
    """
    has_reference = any("reference" in (stream.target, stream.source) for stream in sequence.poses.values())
    return names.stream(sequence, names.reference or ("reference" if has_reference else "tracker"))


def _cells(line: str) -> list[str]:
    """Split a line at commas if it has any, else at blanks."""
    return [cell.strip() for cell in line.split(",")] if "," in line else line.split()


def _header(path: Path, lines: list[list[str]]) -> list[str]:
    """Return the column names, and complete the lines with a header and frame numbers if they lack them."""
    head = lines[0] if lines else []
    bare = bool(head) and all(_is_number(cell) for cell in head)
    count = len(head) // 2 if bare else (len(head) - 1) // 2
    needed = ["frame", *(f"{axis}{k + 1}_px" for k in range(count) for axis in ("column", "row"))]
    if bare and count:
        if len(head) % 2 == 0:
            lines[:] = [[str(i), *line] for i, line in enumerate(lines)]
        lines.insert(0, needed)
    elif count < 1 or head != needed:
        shown = ", ".join(head)[:60] or "none"
        raise UnreadableFileError(
            f"{path} has the columns {shown}; needed frame, column1_px, row1_px, … (or those "
            "numbers without names)"
        )
    return needed


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _numbers(path: Path, number: int, line: list[str], count: int) -> list[float]:
    """Parse the numbers of a line; NaN for an empty cell."""
    if len(line) != count:
        raise UnreadableFileError(f"{path}, line {number}: {len(line)} cells; needed {count}")
    try:
        values = [float(cell) if cell.strip() else float("nan") for cell in line]
    except ValueError as exc:
        raise UnreadableFileError(f"{path}, line {number}: {exc}") from exc
    if any(abs(value) > LARGEST_PX for value in values[1:]):
        raise UnreadableFileError(
            f"{path}, line {number}: a position beyond {LARGEST_PX:g} px; export it again"
        )
    return values
