"""Read temporal-calibration recordings of PLUS: tracker, video, and the line in each video frame."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from dvf_ig.core import FloatArray, IntArray, LatencyRecording, PoseStream, Trace, TrackedSequence
from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.core.plausible import period_problem
from dvf_ig.io import limits
from dvf_ig.io.reading import reading

from .feature_points import tracked_probe
from .names import USUAL_NAMES, ProbeNames
from .poses import usable
from .sequence_read import read_indexed_sequence, read_sequence
from .xml import numbers, parse_xml, write_xml


def read_line_table(xml: Path | str, column_px: float | None = None) -> tuple[IntArray, FloatArray]:
    """Read the rows at which the tank-floor line crosses one image column.

    Args:
        xml: PLUS line-segmentation results.
        column_px: the column; None uses the median column of the lines' points, near the image's centre.
    Returns:
        (k,) frame index in the video file, increasing, and (k,) row in px; frames whose status is not OK
        are omitted.
    Raises:
        UnreadableFileError: absent, not such a table, no frame segmented, or a line parallel to the column.
    """
    path = Path(xml)
    with reading(path, "a line table"):
        frames = list(parse_xml(path, "a line table").iter("Frame"))
        seen = [f for f in frames if f.attrib.get("SegmentationStatus", "OK").upper() == "OK"]
        if not seen:
            raise UnreadableFileError(f"{path}: none of its {len(frames)} frames has a line; record again")
        index = np.array([int(numbers(path, f, "Index", 1)[0]) for f in seen], dtype=np.int64)
        origin = np.array([numbers(path, f, "LineOriginPointPx", 2) for f in seen])
        direction = np.array([numbers(path, f, "LineDirectionVectorPx", 2) for f in seen])
        if (direction[:, 0] == 0).any():
            upright = int(index[direction[:, 0] == 0][0])
            raise UnreadableFileError(
                f"{path}: the line of frame {upright} is vertical; needed the line of a tank floor"
            )
        column = float(np.median(origin[:, 0])) if column_px is None else column_px
        rows = origin[:, 1] + (column - origin[:, 0]) * (direction[:, 1] / direction[:, 0])
        far = int(np.abs(rows).argmax())
        if not abs(rows[far]) <= limits.AXIS:
            raise UnreadableFileError(
                f"{path}: the line of frame {index[far]} crosses column {column:g} at row "
                f"{rows[far]:g}; needed the line of a tank floor"
            )
        order = np.argsort(index, kind="stable")
        if (np.diff(index[order]) == 0).any():
            raise UnreadableFileError(f"{path}: a frame index repeats; needed one line per frame")
        return index[order], rows[order]


def _probe(sequence: TrackedSequence, names: ProbeNames) -> PoseStream:
    if names.reference is None:
        with suppress(InvalidInputError):
            return usable(names.stream(sequence, "tracker"))
    return tracked_probe(sequence, names)


def read_latency_recording(
    tracker_sequence: Path | str,
    video_sequence: Path | str,
    line_table: Path | str,
    names: ProbeNames = USUAL_NAMES,
) -> LatencyRecording:
    """Read tracker poses and the depth of the tank floor at the image's centre column.

    Args:
        tracker_sequence: PLUS sequence with the tracked probe.
        video_sequence: PLUS sequence whose time stamps are the video clock; it may lack images.
        line_table: PLUS line-segmentation results of that video.
        names: of probe and reference in the tracker's sequence; the result calls them "probe" and "tracker".
            Unless a reference is named, poses are relative to the tracker, which does not move.
    Raises:
        UnreadableFileError: a file cannot be read, or the table has more frames than the video.
    """
    with reading(Path(tracker_sequence), "a sequence with a tracked probe"):
        tracked = _probe(read_sequence(tracker_sequence), names)
        probe = replace(tracked, target="tracker", source="probe")
    require_seconds(Path(tracker_sequence), probe.t_s)
    video, frame_indices, frames = read_indexed_sequence(video_sequence)
    if not video.has_timestamps:
        raise UnreadableFileError(
            f"{video_sequence} has no time stamps; needed for the latency: record it again with time stamps"
        )
    require_seconds(Path(video_sequence), video.t_s)
    center = None if video.images is None else (video.images.shape[2] - 1) / 2
    index, rows = read_line_table(line_table, center)
    if index[-1] >= frames:
        raise UnreadableFileError(
            f"{line_table} has frame {index[-1]}, but {video_sequence} ends at frame {frames - 1}"
        )
    position = np.full(frames, -1, dtype=np.int64)
    position[frame_indices] = np.arange(len(frame_indices))
    at = position[index]
    order = np.argsort(at[at >= 0], kind="stable")
    t_s, values = video.t_s[at[at >= 0]][order], rows[at >= 0][order]
    with reading(Path(line_table), "a line table"):
        return LatencyRecording(probe, Trace(t_s, values))


def require_seconds(path: Path, t_s: FloatArray) -> None:
    """Raise UnreadableFileError if the stamps of a recording cannot be in seconds."""
    if problem := period_problem(t_s):
        raise UnreadableFileError(f"{path} has {problem}")


def write_line_table(path: Path | str, rows_px: FloatArray, column_px: float = 0.0) -> None:
    """Write horizontal lines in PLUS's format, one per video frame; NaN marks a frame as Failed.

    Args:
        rows_px: (n,) row of the line in each frame.
        column_px: column of the point that is written for each line.
    Raises:
        InvalidInputError: not one row per frame.
        OutputError: not writable.
    """
    if rows_px.ndim != 1:
        raise InvalidInputError(f"line rows have shape {rows_px.shape}; needed one row per frame, (n,)")
    root = ElementTree.Element("LineSegmentationResults")
    for index, row in enumerate(rows_px.tolist()):
        element = ElementTree.SubElement(root, "Frame", Index=str(index))
        element.set("SegmentationStatus", "OK" if row == row else "Failed")
        if row == row:
            element.set("LineOriginPointPx", f"{column_px!r} {row!r}")
            element.set("LineDirectionVectorPx", "1 0")
    write_xml(Path(path), root)
