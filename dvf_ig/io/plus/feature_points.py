"""Read segmented points of a calibration target: a table with one row per image."""

from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, PoseStream, TrackedSequence, UnreadableFileError
from dvf_ig.io import limits
from dvf_ig.io.number_table import read_number_table
from dvf_ig.io.reading import reading

from .names import USUAL_NAMES, ProbeNames
from .poses import SEQUENCE_SUFFIXES, read_poses, usable
from .raw_sequence import turned_points
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
    with reading(path, "segmented points"):
        numbers, points = _rows(path)
    if (np.abs(points[np.isfinite(points)]) > LARGEST_PX).any():
        raise UnreadableFileError(f"{path} has a position beyond {LARGEST_PX:g} px; export it again")
    half = np.isnan(points).sum(axis=2) == 1
    if half.any():
        raise UnreadableFileError(
            f"{path}: a point of frame {numbers[half.sum(axis=1) > 0][0]:g} has a column or a row alone; "
            "give both, or leave both empty"
        )
    whole = (numbers >= 0) & (numbers < limits.FRAMES) & (numbers == np.floor(numbers))
    if not whole.all():
        raise UnreadableFileError(
            f"{path}: '{numbers[np.argmin(whole)]:g}' is not a frame number (0, 1, 2, …)"
        )
    last = int(numbers.max(initial=-1))
    total = last + 1 if frames is None else frames
    if len(set(numbers.tolist())) < len(numbers):
        raise UnreadableFileError(f"{path} lists a frame twice; needed one row per image")
    if last >= total:
        raise UnreadableFileError(f"{path} has frame {last}, the sequence has {total} images")
    out = np.full((total, *points.shape[1:]), np.nan)
    out[numbers.astype(np.int64)] = points
    return out


def _rows(path: Path) -> tuple[FloatArray, FloatArray]:
    """Read (rows,) frames and (rows, points, 2) positions; an even number of columns lacks the frame."""
    table = read_number_table(path, "segmented points: frame, column1_px, row1_px, …")
    values, count = table.values, (table.values.shape[1] - 1) // 2
    needed = ("frame", *(f"{axis}{k + 1}" for k in range(count) for axis in ("column", "row")))
    if table.names is None and values.shape[1] % 2 == 0:
        values = np.column_stack([np.arange(len(values)), values])
    elif (
        count < 1 or table.names not in (None, needed) or any(unit not in ("", "px") for unit in table.units)
    ):
        raise UnreadableFileError(
            f"{path} has the columns {', '.join(table.names or ())[:60] or values.shape[1]}; needed frame, "
            "column1_px, row1_px, … (or those numbers without names)"
        )
    return values[:, 0], values[:, 1:].reshape(len(values), -1, 2)


def read_target_recording(
    poses_path: Path | str, points_path: Path | str, names: ProbeNames = USUAL_NAMES
) -> tuple[PoseStream, FloatArray]:
    """Read poses of the tracked probe and the target's points, matched frame by frame.

    Args:
        poses_path: PLUS sequence with the probe tracked against the reference sensor or the tracker; or poses
            as text, one row or file per frame (see `read_poses`).
        points_path: see `read_feature_points`; frame numbers count the frames of the poses' file from 0,
            positions are those of the images as the file stores them.
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
    points_px = read_feature_points(points_path, frames)[indices]
    if sequence.turned_from is None or sequence.images is None:
        return poses, points_px
    rows, columns = sequence.images.shape[1:]
    return poses, turned_points(points_px, sequence.turned_from, (rows, columns))


def tracked_probe(sequence: TrackedSequence, names: ProbeNames = USUAL_NAMES) -> PoseStream:
    """Return the probe's pose relative to the reference sensor if one was tracked, else to the tracker.

    Raises:
        InvalidInputError: the sequence does not connect the two frames, or its positions cannot be in mm.
    """
    has_reference = any("reference" in (stream.target, stream.source) for stream in sequence.poses.values())
    return usable(names.stream(sequence, names.reference or ("reference" if has_reference else "tracker")))
