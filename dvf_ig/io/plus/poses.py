"""Read pose streams from a PLUS sequence, a folder of 4×4 text files, or a table of quaternions."""

import re
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.core.recordings.sequence import TrackedSequence
from dvf_ig.core.recordings.stream import PoseStream
from dvf_ig.io import limits
from dvf_ig.io.reading import read_text, reading

from .sequence_read import read_sequence

SEQUENCE_SUFFIXES = (".mha", ".mhd", ".nrrd", ".nhdr")
LARGEST = 1e12
"""Largest number in a table; squares of larger ones may overflow."""
_USUAL_TOOLS = ("stylus", "tool")


def read_poses(path: Path | str, target: str | None = None, source: str | None = None) -> PoseStream:
    """Read target_from_source over time.

    Args:
        path: a PLUS sequence; a folder of text files with one 4×4 each, in natural order of their names; or a
            text table with rows `x y z qx qy qz qw` (or `t x y z qx qy qz qw`), mm and s.
        target, source: frames. Without them, the only tracked tool of a sequence is used, relative to the
            reference sensor if one is recorded; for text they name the frames, by default
            tracker_from_tool.
    Returns:
        the poses; without times, sample i is at i seconds.
    Raises:
        UnreadableFileError: absent, malformed, or not rotations.
        InvalidInputError: a sequence has several tools and none is chosen; the message lists them.
    """
    path = Path(path)
    with reading(path, "tool poses (a PLUS sequence, a folder of 4x4 text files, or a text table)"):
        if not path.exists():
            raise FileNotFoundError(path)
        if path.suffix.lower() in SEQUENCE_SUFFIXES:
            return _from_sequence(path, read_sequence(path), target, source)
        if path.is_dir():
            times, matrices = _read_folder(path)
        else:
            times, matrices = _read_table(path)
        limits.require_times(times, "its column of times")
        limits.require_lengths(matrices, "a pose")
        valid = np.ones(len(matrices), dtype=np.bool_)
        rotations, translations = matrices[:, :3, :3], matrices[:, :3, 3]
        return PoseStream(target or "tracker", source or "tool", times, rotations, translations, valid)


def _from_sequence(
    path: Path, sequence: TrackedSequence, target: str | None, source: str | None
) -> PoseStream:
    frames = {stream.target for stream in sequence.poses.values()}
    tools = sorted({stream.source for stream in sequence.poses.values()} - {"reference"})
    if source is None:
        usual = [tool for tool in tools if tool in _USUAL_TOOLS]
        candidates = tools if len(tools) == 1 else usual
        if len(candidates) != 1:
            listed = ", ".join(sorted(sequence.poses)) or "no transform"
            raise InvalidInputError(f"the sequence records several tools or none ({listed}): name one")
        source = candidates[0]
    if target is None:
        recorded = sorted(frames | {stream.source for stream in sequence.poses.values()})
        target = (
            "reference"
            if "reference" in recorded and source != "reference"
            else _tracked_in(sequence, source)
        )
    return sequence.stream(target, source)


def _tracked_in(sequence: TrackedSequence, source: str) -> str:
    targets = sorted(s.target for s in sequence.poses.values() if s.source == source)
    if not targets:
        listed = ", ".join(sorted(sequence.poses)) or "no transform"
        raise InvalidInputError(f"the sequence does not track '{source}'; it records {listed}")
    return targets[0]


def _read_folder(folder: Path) -> tuple[FloatArray, FloatArray]:
    files = sorted((f for f in folder.iterdir() if f.is_file() and f.name[0] != "."), key=_natural)
    if not files:
        raise UnreadableFileError(f"{folder} is empty; needed text files with one 4x4 matrix each")
    matrices = np.stack([_read_matrix(file) for file in files])
    return np.arange(len(files), dtype=np.float64), matrices


def _natural(path: Path) -> list[tuple[int, str]]:
    """Build a sort key in which file2 comes before file10."""
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def _read_matrix(path: Path) -> FloatArray:
    rows = _numbers(path)
    if rows.size != 16:
        raise UnreadableFileError(f"{path} holds {rows.size} numbers; needed the 16 of a 4x4 matrix")
    matrix = rows.reshape(4, 4)
    if not np.allclose(matrix[3], (0, 0, 0, 1), atol=1e-9):
        raise UnreadableFileError(f"{path}: the last row is {matrix[3].tolist()}; needed 0 0 0 1")
    return matrix


def _read_table(path: Path) -> tuple[FloatArray, FloatArray]:
    table = _numbers(path)
    if table.shape[1] not in (7, 8):
        raise UnreadableFileError(
            f"{path} has {table.shape[1]} columns; needed x y z qx qy qz qw (7), or a time first (8)"
        )
    times = np.arange(len(table), dtype=np.float64) if table.shape[1] == 7 else table[:, 0]
    position, quaternion = table[:, -7:-4], table[:, -4:]
    norm = np.linalg.norm(quaternion, axis=1)
    if (np.abs(norm - 1) > 1e-2).any():
        row = int(np.abs(norm - 1).argmax())
        raise UnreadableFileError(
            f"{path}: the quaternion of row {row + 1} has length {norm[row]:.3g}; needed unit quaternions "
            "in the order qx qy qz qw"
        )
    matrices = np.tile(np.eye(4), (len(table), 1, 1))
    matrices[:, :3, :3] = Rotation.from_quat(quaternion).as_matrix()
    matrices[:, :3, 3] = position
    return times, matrices


def _numbers(path: Path) -> FloatArray:
    """Read the (rows, columns) of a text table with blanks or commas; skip lines that start with # or %."""
    lines = [line for line in read_text(path, "a text table").replace(",", " ").splitlines() if line.strip()]
    rows = [line.split() for line in lines if line.lstrip()[0] not in "#%"]
    try:
        table = np.array([[float(cell) for cell in row] for row in rows])
    except ValueError as exc:
        raise UnreadableFileError(f"{path} is not a table of numbers: {exc}") from exc
    if table.ndim != 2 or not (np.abs(table) < LARGEST).all():
        raise UnreadableFileError(
            f"{path}: needed rows of finite numbers below {LARGEST:g}, each of the same length"
        )
    return table
