"""Write tracked sequences as PLUS / 3D Slicer `.igs.mha`, and registrations over time as `.seq.mha`."""

import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dvf_ig.core import RAS_FROM_LPS, FloatArray, InvalidInputError, OutputError, PoseStream, TrackedSequence
from dvf_ig.core.space.rigid import Rigid
from dvf_ig.io.provenance import SEQUENCE_COMMENT
from dvf_ig.io.writing.atomic import write_bytes

from .names import join_transform

_LAST_ROW = "0 0 0 1"


def write_sequence(sequence: TrackedSequence, path: Path | str, *, compression: int = 1) -> None:
    """Write a sequence so that PLUS, 3D Slicer and `read_sequence` read the same content.

    Numbers are written with the fewest digits that read back to the same float64.

    Args:
        sequence: what to write; invalid poses are written with status INVALID.
        path: a name ending in `.mha`, usually `.igs.mha`.
        compression: zlib level of the images, 1 (fast) to 9; 0 disables compression.
    Raises:
        OutputError: another ending, or not writable.
        InvalidInputError: a frame name that is not valid in PLUS.
    """
    images = sequence.images
    pixels = b"" if images is None else np.ascontiguousarray(images).data
    compressed = images is not None and compression > 0
    payload = zlib.compress(pixels, compression) if compressed else bytes(pixels)
    header = _header_lines(sequence, len(sequence), compressed, len(payload))
    _write(Path(path), header, [sequence], payload)


def write_poses(stream: PoseStream, path: Path | str, after_restart: PoseStream | None = None) -> None:
    """Write one pose stream as a pose-only sequence (`.igs.mha`).

    Args:
        after_restart: later poses of the same name, from a restarted clock; their frames follow with their
            own stamps.
    """
    parts = [
        TrackedSequence(s.t_s, None, np.zeros(len(s), dtype=np.bool_), {s.name: s}, orientation="XX")
        for s in (stream, after_restart)
        if s is not None
    ]
    frames = sum(len(part) for part in parts)
    _write(Path(path), _header_lines(parts[0], frames, compressed=False, payload=0), parts, b"")


def write_pose_sequence(poses: Sequence[tuple[float, Rigid]], path: Path | str) -> None:
    """Write a registration over time as a linear transform sequence of 3D Slicer (`.seq.mha`).

    Slicer uses the matrix of `Seq_FrameNNNN_TrackerToRasTransform` unchanged as *transform to parent*. It
    maps a point from the tracker to the MR in RAS, p_ras = diag(−1, −1, 1)·p_mr: the node's children, for
    example a PLUS sequence with its ProbeToTracker, appear on the MR. (A `.tfm` holds the inverse, and Slicer
    treats both of its frames as LPS.)

    Args:
        poses: (start of validity, s; mr_from_tracker) in order of time; at least one.
        path: a name ending in `.seq.mha`.
    Raises:
        InvalidInputError: no poses, or several pairs of frames.
        OutputError: another ending, or not writable.
    Source: Slicer, vtkMRMLLinearTransformSequenceStorageNode: field names, SetMatrixTransformToParent; index
    "time" in s, which it rounds to 1 ms.
    """
    path = Path(path)
    if not path.name.endswith(".seq.mha"):
        raise OutputError(
            f"cannot write {path}: transform sequences are written as .seq.mha; change the name"
        )
    frames = {(pose.target, pose.source) for _, pose in poses}
    if len(frames) != 1:
        raise InvalidInputError(f"a transform sequence needs poses of one pair of frames; got {len(frames)}")
    target, source = frames.pop()
    name = join_transform("ras", source)
    comment = (
        f"{name}: p_ras = M p_{source}, mm, row-major 4x4, to parent; "
        f"p_ras = diag(-1, -1, 1) p_{target}; {source} as its device reports it; Timestamp in s: start "
        "of the pose's use"
    )
    matrices = np.array([RAS_FROM_LPS @ pose.matrix for _, pose in poses])
    write_transform_sequence(name, [from_s for from_s, _ in poses], matrices, path, comment)


def write_transform_sequence(
    name: str, t_s: Sequence[float], matrices: FloatArray, path: Path, comment: str
) -> None:
    """Write matrices over time as a linear transform sequence of 3D Slicer (`.seq.mha`).

    Args:
        name: in PLUS's spelling, for example "ProbeToTracker".
        t_s: (n,) s, in order of time.
        matrices: (n, 4, 4) *transform to parent*, mm; written unchanged.
        comment: their meaning, for people.
    Raises:
        OutputError: not writable.
    """
    lines = [
        "ObjectType = Image",
        "NDims = 3",
        f"Comment = {SEQUENCE_COMMENT}; {comment}",
        "AnatomicalOrientation = RAI",
        "BinaryData = True",
        "CompressedData = False",
        f"DimSize = 0 0 {len(matrices)}",
        "ElementSpacing = 1 1 1",
        "Offset = 0 0 0",
        "TransformMatrix = 1 0 0 0 1 0 0 0 1",
        "ElementType = MET_UCHAR",
        "Kinds = domain domain list",
    ]
    width = max(4, len(str(len(matrices) - 1)))
    for i, (stamp_s, matrix) in enumerate(zip(t_s, matrices, strict=True)):
        text = " ".join(map(repr, (matrix[:3] + 0.0).ravel().tolist()))  # no negative zeros
        prefix = f"Seq_Frame{i:0{width}d}_"
        lines.append(f"{prefix}{name}Transform = {text} {_LAST_ROW}")
        lines.append(f"{prefix}{name}TransformStatus = OK")
        lines.append(f"{prefix}Timestamp = {float(stamp_s)!r}")
    write_bytes(path, ["\n".join([*lines, "ElementDataFile = LOCAL\n"]).encode()])


def _write(path: Path, header: list[str], parts: Sequence[TrackedSequence], payload: bytes) -> None:
    """Write one file: the header, the frames of every part in order of arrival, the pixels."""
    if path.suffix != ".mha":
        raise OutputError(f"cannot write {path}: sequences are written as .igs.mha; change the ending")
    frames = sum(len(part) for part in parts)
    lines, first = list(header), 0
    for part in parts:
        lines += _frame_lines(part, first, frames)
        first += len(part)
    write_bytes(path, ["\n".join([*lines, "ElementDataFile = LOCAL\n"]).encode(), payload])


def _header_lines(sequence: TrackedSequence, frames: int, compressed: bool, payload: int) -> list[str]:
    images = sequence.images
    rows, columns = (0, 0) if images is None else images.shape[1:]
    lines = [
        "ObjectType = Image",
        "NDims = 3",
        "AnatomicalOrientation = RAI",
        "BinaryData = True",
        "BinaryDataByteOrderMSB = False",
        "CenterOfRotation = 0 0 0",
        f"CompressedData = {compressed}",
    ]
    if compressed:
        lines.append(f"CompressedDataSize = {payload}")
    return [
        *lines,
        f"DimSize = {columns} {rows} {frames}",
        "Kinds = domain domain list",
        "ElementNumberOfChannels = 1",
        "ElementSpacing = 1 1 1",
        f"ElementType = {'MET_OTHER' if images is None else 'MET_UCHAR'}",
        "Offset = 0 0 0",
        "TransformMatrix = 1 0 0 0 1 0 0 0 1",
        f"UltrasoundImageOrientation = {sequence.orientation}",
        f"UltrasoundImageType = {'XX' if images is None else 'BRIGHTNESS'}",
    ]


def _frame_lines(sequence: TrackedSequence, first: int, frames: int) -> list[str]:
    """Build the field lines of the frames of a part that starts at frame `first` of `frames`."""
    width = max(4, len(str(frames - 1)))
    streams = [
        (f"{join_transform(s.target, s.source)}Transform", _matrix_texts(s), s.valid.tolist())
        for s in sequence.poses.values()
    ]
    times = [repr(t) for t in sequence.t_s.tolist()] if sequence.has_timestamps else None
    lines: list[str] = []
    for i, image_ok in enumerate(sequence.image_valid.tolist()):
        prefix = f"Seq_Frame{first + i:0{width}d}_"
        for name, texts, valid in streams:
            lines.append(f"{prefix}{name} = {texts[i]}")
            lines.append(f"{prefix}{name}Status = {'OK' if valid[i] else 'INVALID'}")
        if times is not None:
            lines.append(f"{prefix}Timestamp = {times[i]}")
        lines.append(f"{prefix}ImageStatus = {'OK' if image_ok else 'INVALID'}")
    return lines


def _matrix_texts(stream: PoseStream) -> list[str]:
    """Format the row-major 4×4 matrix of each sample."""
    rows = np.concatenate([stream.rotations, stream.translations_mm[:, :, None]], axis=2).reshape(-1, 12)
    return [" ".join(map(repr, row)) + " " + _LAST_ROW for row in rows.tolist()]
