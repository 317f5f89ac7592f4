"""Read PLUS / 3D Slicer tracked sequences: `.igs.mha`, `.igs.mhd`, `.igs.nrrd`."""

import logging
from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import BoolArray, FloatArray, IntArray
from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.core.recordings.sequence import TrackedSequence
from dvf_ig.core.recordings.stream import PoseStream
from dvf_ig.io import limits
from dvf_ig.io.reading import reading

from .names import split_transform
from .raw_sequence import RawSequence, read_raw_sequence

log = logging.getLogger(__name__)

PIXEL_FRAMES = ("image", "transducer_origin_pixel")
"""Frames whose unit is the pixel: transforms from or to them carry scale and are image maps, not poses."""

REORDERING_S = 0.1
"""Frames may stand this much out of order in a file. A recorder's buffers and threads swap neighbours, and in
the slowest streams in use (12 frames/s) these are 0.08 s apart; a clock that restarts goes back further."""


def read_sequence(path: Path | str) -> TrackedSequence:
    """Read a tracked sequence.

    Frames that repeat an earlier time stamp are dropped, and frames out of order by up to REORDERING_S are
    sorted. Where time runs back further, the recording ends and no later frame is used: stamps before and
    after are of two clocks. All of it is logged. Without time stamps `t_s` is the frame index and
    `has_timestamps` is False. Without status fields a pose counts as OK. A pose whose status is not OK is
    invalid and its matrix is not looked at. Transforms from or to pixel frames (ImageToProbe) are left out:
    they are image maps.

    Args:
        path: `.igs.mha`, `.igs.mhd`, `.igs.nrrd`, or the same without `.igs`.
    Returns:
        the sequence; matrices keep the digits of the file, images and their orientation are as stored.
    Raises:
        UnreadableFileError: absent, not a sequence, truncated, not uint8, or with malformed fields.
    """
    return read_indexed_sequence(path)[0]


def read_indexed_sequence(path: Path | str) -> tuple[TrackedSequence, IntArray, int]:
    """As `read_sequence`, with the index in the file of each kept frame, (n,), and the file's frame count."""
    path = Path(path)
    with reading(path, "a tracked sequence"):
        raw = read_raw_sequence(path)
        return *indexed_sequence(path, raw), raw.frames


def indexed_sequence(path: Path, raw: RawSequence) -> tuple[TrackedSequence, IntArray]:
    """The same of a sequence that was taken apart already; without its pixels it has no images."""
    with reading(path, "a tracked sequence"):
        t_s, has_timestamps = _times(path, raw)
        kept = _usable_order(path, t_s)
        t_s = t_s[kept]
        sequence = TrackedSequence(
            t_s=t_s,
            images=_images(raw, kept),
            image_valid=_statuses(raw, _image_status_field(raw))[kept],
            poses=_streams(path, raw, t_s, kept),
            has_timestamps=has_timestamps,
            orientation=_orientation(raw),
        )
    return sequence, kept


def _times(path: Path, raw: RawSequence) -> tuple[FloatArray, bool]:
    """(frames,) time stamps as stored, or the frame index where the file has none."""
    texts = raw.frame_fields.get("Timestamp")
    if not texts:
        return np.arange(raw.frames, dtype=np.float64), False
    missing = [i for i in range(raw.frames) if i not in texts]
    if missing:
        raise UnreadableFileError(
            f"{path}: {len(missing)} of {raw.frames} frames have no Timestamp (first: frame {missing[0]}); "
            "needed one on every frame or on none"
        )
    try:
        t_s = np.array([float(texts[i]) for i in range(raw.frames)])
    except ValueError as exc:
        raise UnreadableFileError(f"{path}: a Timestamp is not a number ({exc})") from exc
    if not np.isfinite(t_s).all():
        bad = int(np.flatnonzero(~np.isfinite(t_s))[0])
        raise UnreadableFileError(f"{path}: the Timestamp of frame {bad} is not finite; record again")
    limits.require_times(t_s, "a Timestamp")
    return t_s, True


def _usable_order(path: Path, t_s: FloatArray) -> IntArray:
    """Frame indices by increasing time, up to a clock's restart; of equal times the first in the file."""
    restart = clock_restart(t_s)
    frames = len(t_s) if restart is None else restart
    if restart is not None:
        latest_s = float(t_s[:restart].max())
        log.warning(
            "%s: time jumps back by %.3f s at frame %d (from %.3f s to %.3f s), as when a clock restarts; "
            "the %d frames from there on are not used: split the file there, or record again",
            path,
            latest_s - t_s[restart],
            restart,
            latest_s,
            t_s[restart],
            len(t_s) - restart,
        )
    order = np.argsort(t_s[:frames], kind="stable")
    kept = order[np.concatenate([[True], np.diff(t_s[order]) > 0])]
    late = int(np.count_nonzero(np.diff(t_s[:frames]) < 0))
    if len(kept) < frames or late:
        log.warning(
            "%s: dropped %d of %d frames that repeat a time stamp; time runs backwards at %d places, sorted",
            path,
            frames - len(kept),
            frames,
            late,
        )
    return np.asarray(kept, dtype=np.int64)


def clock_restart(t_s: FloatArray) -> int | None:
    """The first frame stamped more than REORDERING_S before an earlier one, by its index; None without one.

    Args:
        t_s: (frames,) stamps in the order of the file.
    """
    restarts = np.flatnonzero(np.maximum.accumulate(t_s) - t_s > REORDERING_S)
    return int(restarts[0]) if len(restarts) else None


def _images(raw: RawSequence, kept: IntArray) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]] | None:
    if not len(raw.pixels):
        return None
    images = np.frombuffer(raw.pixels, np.uint8).reshape(raw.frames, raw.rows, raw.columns)
    in_order = len(kept) == raw.frames and bool((np.diff(kept) > 0).all())
    return images if in_order else images[kept]


def _statuses(raw: RawSequence, name: str) -> BoolArray:
    """(frames,) True where the status field says OK or is absent."""
    texts = raw.frame_fields.get(name, {})
    return np.array([texts.get(i, "OK").upper() == "OK" for i in range(raw.frames)])


def _image_status_field(raw: RawSequence) -> str:
    """PLUS calls it ImageStatus in MetaImage files and Status in NRRD files."""
    return "ImageStatus" if "ImageStatus" in raw.frame_fields else "Status"


def _orientation(raw: RawSequence) -> str:
    for name in ("UltrasoundImageOrientation", "ultrasound image orientation"):
        if name in raw.fields:
            return raw.fields[name]
    return "XX"


def _streams(path: Path, raw: RawSequence, t_s: FloatArray, kept: IntArray) -> dict[str, PoseStream]:
    streams: dict[str, PoseStream] = {}
    for field in sorted(raw.frame_fields):
        frames = split_transform(field.removesuffix("Transform")) if field.endswith("Transform") else None
        if frames is None:
            continue
        target, source = frames
        if target in PIXEL_FRAMES or source in PIXEL_FRAMES:
            log.info("%s: %s is an image map, not a pose; left out", path, field)
            continue
        matrices, valid = _matrices(path, raw, field)
        matrices, valid = matrices[kept], valid[kept]
        stream = PoseStream(target, source, t_s, matrices[:, :3, :3], matrices[:, :3, 3], valid)
        streams[stream.name] = stream
    return streams


def _matrices(path: Path, raw: RawSequence, field: str) -> tuple[FloatArray, BoolArray]:
    """(frames, 4, 4) as stored (NaN where absent or malformed and not OK) and (frames,) validity."""
    texts = raw.frame_fields[field]
    valid = _statuses(raw, f"{field}Status") & np.array([i in texts for i in range(raw.frames)])
    flat = np.full((raw.frames, 16), np.nan)
    for i, text in texts.items():
        if i >= raw.frames:
            raise UnreadableFileError(
                f"{path}: a field of frame {i} ({field}), but the header counts {raw.frames} frames"
            )
        try:
            numbers = [float(part) for part in text.split()]
        except ValueError:
            numbers = []
        if len(numbers) == 16:
            flat[i] = numbers
        elif valid[i]:
            raise UnreadableFileError(
                f"{path}: {field} of frame {i} is '{text[:40]}'; needed 16 numbers (a row-major 4x4 matrix)"
            )
    matrices = flat.reshape(-1, 4, 4)
    given = matrices[valid]
    limits.require_lengths(given[np.isfinite(given)], field)
    if (np.abs(matrices[valid][:, 3] - (0, 0, 0, 1)) > 1e-9).any():
        raise UnreadableFileError(f"{path}: {field} has a last row other than 0 0 0 1")
    return matrices, valid
