"""Read pose streams from a PLUS sequence, a folder of 4×4 text files, or a table of quaternions."""

import logging
import re
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import BoolArray, FloatArray, InvalidInputError, TrackedSequence, UnreadableFileError
from dvf_ig.core.plausible import identities, marker_problem, period_problem
from dvf_ig.core.recordings.stream import PoseStream
from dvf_ig.io import limits
from dvf_ig.io.number_table import NumberTable, read_number_table, scaled
from dvf_ig.io.reading import reading
from dvf_ig.io.table_text import MM_IN

from .sequence_read import SEQUENCE_SUFFIXES as SEQUENCE_SUFFIXES
from .sequence_read import read_sequence

_USUAL_TOOLS = ("stylus", "tool")
_IN_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_NAMES = {
    "t": {"t", "time", "times", "timestamp", "stamp", "seconds", "sec"},
    **{axis: {axis, f"t{axis}", f"p{axis}", f"pos_{axis}", f"position_{axis}"} for axis in "xyz"},
    **{
        f"q{axis}": {f"q{axis}", f"q{i}", f"quat_{axis}", f"rot_{axis}", f"orientation_{axis}"}
        for i, axis in enumerate("xyz", 1)
    },
    "qw": {"qw", "q0", "qs", "quat_w", "rot_w", "orientation_w"},
}
"""Names of the columns of a pose in the tables of trackers, in the order of a table without names."""
_VALID = ("valid", "is_valid", "visible", "tracked", "status", "state", "quality_ok")
_GOOD = ("1", "ok", "true", "yes", "valid", "visible", "tracked", "enabled", "good")
"""Columns that say whether a pose was measured (a number: not 0), and the words for one that was."""
_TOOL = ("tool", "tool_id", "name", "marker", "sensor", "port", "handle", "body", "id", "child_frame_id")
"""Columns that say whose pose a row is."""
log = logging.getLogger(__name__)


def read_poses(path: Path | str, target: str | None = None, source: str | None = None) -> PoseStream:
    """Read target_from_source over time.

    Args:
        path: a PLUS sequence; a folder of text files with one 4×4 each, in natural order of their names; or a
            text table with rows `x y z qx qy qz qw` (or `t x y z qx qy qz qw`), mm and s. A row with the
            names of the columns gives their order and units (`x [m]`, `t_ms`). Rows that are incomplete, nan
            or all zero, and poses that are exactly the identity, are lost poses.
        target, source: frames. Without them, the only tracked tool of a sequence is used, relative to the
            reference sensor if one is recorded; for text they name the frames, by default
            tracker_from_tool.
    Returns:
        the poses; without times, sample i is at i seconds.
    Raises:
        UnreadableFileError: absent, malformed, not rotations, or positions that cannot be in mm.
        InvalidInputError: a sequence has several tools and none is chosen; the message lists them.
    """
    path = Path(path)
    with reading(path, "tool poses"):
        return usable(recorded_poses(path, target, source))


def recorded_poses(path: Path, target: str | None = None, source: str | None = None) -> PoseStream:
    """Read poses as `read_poses` does, in whatever unit they are; what uses them judges it."""
    with reading(path, "tool poses (a PLUS sequence, a folder of 4x4 text files, or a text table)"):
        if not path.exists():
            raise FileNotFoundError(path)
        if path.suffix.lower() in SEQUENCE_SUFFIXES:
            return _from_sequence(read_sequence(path), target, source)
        times, matrices = _read_folder(path) if path.is_dir() else _read_table(path)
        limits.require_times(times, "its column of times")
        valid = np.isfinite(matrices).all(axis=(1, 2)) & ~identities(matrices)
        limits.require_lengths(matrices[valid], "a pose")
        if not valid.all():
            log.warning(
                f"{path}: {(~valid).sum()} of {len(valid)} poses were lost (nan, empty, zero, exactly the "
                "identity, or marked so)"
            )
        if problem := period_problem(times):
            log.warning("%s has %s", path, problem)
        rotations, translations = matrices[:, :3, :3], matrices[:, :3, 3]
        return PoseStream(target or "tracker", source or "tool", times, rotations, translations, valid)


def usable(stream: PoseStream) -> PoseStream:
    """Return a stream whose positions can be in mm.

    Raises:
        InvalidInputError: they cannot; the message states the likely unit.
    """
    if problem := marker_problem(stream.name, stream.translations_mm[stream.valid]):
        raise InvalidInputError(problem)
    return stream


def _from_sequence(sequence: TrackedSequence, target: str | None, source: str | None) -> PoseStream:
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
    rows = read_number_table(path, "the rows of a 4x4 matrix").values
    if rows.size != 16:
        raise UnreadableFileError(f"{path} holds {rows.size} numbers; needed the 16 of a 4x4 matrix")
    matrix = rows.reshape(4, 4)
    if not np.allclose(matrix[3], (0, 0, 0, 1), atol=1e-9) and not np.isnan(matrix).all():
        raise UnreadableFileError(f"{path}: the last row is {matrix[3].tolist()}; needed 0 0 0 1")
    return matrix


def _read_table(path: Path) -> tuple[FloatArray, FloatArray]:
    """Read (n,) times and (n, 4, 4) matrices; NaN for rows that are incomplete or all zero."""
    table = read_number_table(path, "poses: rows x y z qx qy qz qw, or with a time first")
    at = _columns(path, table)
    position = scaled(path, table, at[1:4], MM_IN)
    quaternion = table.values[:, at[4:]]
    if at[0] < 0:
        times = np.arange(len(position), dtype=np.float64)
    else:
        times = scaled(path, table, at[:1], _IN_S)[:, 0]
    pose = np.column_stack([position, quaternion])
    unseen = ~position.any(axis=1) & position.any()
    if unseen.any():
        log.warning(
            f"{path}: {np.count_nonzero(unseen)} poses lie exactly at the origin, as programs write poses "
            "that were lost, and count so"
        )
    lost = np.isnan(pose).any(axis=1) | unseen | ~pose.any(axis=1) | ~_marked_valid(path, table)
    norm = np.where(lost, 1.0, np.linalg.norm(quaternion, axis=1))
    if (np.abs(norm - 1) > 1e-2).any():
        row = int(np.abs(norm - 1).argmax())
        raise UnreadableFileError(
            f"{path}, line {table.lines[row]}: the quaternion of row {row + 1} has length {norm[row]:.3g}; "
            "needed unit quaternions in the order qx qy qz qw, or columns with names"
        )
    matrices = np.tile(np.eye(4), (len(pose), 1, 1))
    matrices[~lost, :3, :3] = Rotation.from_quat(quaternion[~lost]).as_matrix()
    matrices[:, :3, 3] = position
    matrices[lost] = np.nan
    return times, matrices


def _marked_valid(path: Path, table: NumberTable) -> BoolArray:
    """Return (n,) True for the rows that no column of words or numbers marks as not measured.

    Raises:
        UnreadableFileError: the rows are poses of several tools.
    """
    numbers = {name: table.values[:, at] for at, name in enumerate(table.names or ())}
    valid = np.ones(len(table.values), dtype=np.bool_)
    for name, cells in (*numbers.items(), *table.texts.items()):
        several = sorted(set(map(str, cells)))
        if name in _TOOL and 1 < len(several) < 0.5 * len(cells):
            raise UnreadableFileError(
                f"{path} holds poses of several tools (column '{name}': {', '.join(several)[:60]}); write "
                "one file per tool"
            )
        if name in _VALID and name in table.texts:
            valid &= [cell.lower() in _GOOD for cell in table.texts[name]]
        elif name in _VALID and len(several) <= 2:
            valid &= numbers[name] != 0
    return valid


def _columns(path: Path, table: NumberTable) -> list[int]:
    """Find the columns of time (-1 without one), position and quaternion by their names, else by their count.

    Other columns are listed in a logged warning.
    """
    count = table.values.shape[1]
    names = table.names or ()
    quantities = [next((q for q, words in _NAMES.items() if name in words), None) for name in names]
    if not all(quantities.count(quantity) == 1 for quantity in _NAMES if quantity != "t"):
        if names and any(quantities):
            lacking = [quantity for quantity in _NAMES if quantity != "t" and quantities.count(quantity) != 1]
            raise UnreadableFileError(
                f"{path} has the columns {', '.join(names)[:80]}; needed each of x, y, z, qx, qy, qz, "
                f"qw once (not {', '.join(lacking)}): name them so"
            )
        if count not in (7, 8):
            raise UnreadableFileError(
                f"{path} has {count} columns; needed x y z qx qy qz qw (7), or a time first (8), or "
                "a row with their names"
            )
        log.warning(
            "%s names no columns: they are taken as %sx y z qx qy qz qw, the scalar last",
            path,
            "" if count == 7 else "t ",
        )
        return [*([-1] if count == 7 else []), *range(count)]
    if quantities.count("t") > 1:
        raise UnreadableFileError(f"{path} has two columns of times ({', '.join(names)[:70]}); delete one")
    other = [name for name, quantity in zip(names, quantities, strict=True) if quantity is None]
    other = [name or "without a name" for name in (*other, *table.texts) if name not in _VALID]
    if other:
        log.warning("%s: the columns %s are not part of a pose and are left out", path, ", ".join(other))
    return [quantities.index(quantity) if quantity in quantities else -1 for quantity in _NAMES]
