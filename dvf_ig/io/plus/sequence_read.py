"""Read PLUS / 3D Slicer tracked sequences: `.igs.mha`, `.igs.mhd`, `.igs.nrrd`."""

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import BoolArray, FloatArray, IntArray, PoseStream, TrackedSequence, UnreadableFileError
from dvf_ig.core.plausible import identities, period_problem
from dvf_ig.io import limits
from dvf_ig.io.reading import reading

from .names import split_transform
from .raw_sequence import (
    UNKNOWN,
    RawSequence,
    read_raw_sequence,
    require_orientation,
    turned_images,
    turned_orientation,
)

log = logging.getLogger(__name__)

SEQUENCE_SUFFIXES = (".mha", ".mhd", ".nrrd", ".nhdr")
PIXEL_FRAMES = ("image", "transducer_origin_pixel")
"""Frames in pixels: transforms from or to them carry scale and are image maps, not poses."""

MOST_BARE = 0.5
"""Share of frames without a time stamp from which the file is refused; fewer such frames are left out."""
LISTED = 10
"""Most numbers of frames that a message lists."""
REORDERING_S = 0.1
"""Largest step back in time of frames that are only out of order. A recorder's buffers and threads swap
neighbours, 0.08 s apart in the slowest streams (12 frames/s); a restarted clock goes back further."""


_B_MODE = "BRIGHTNESS"
_STATUSES = {
    *(
        "OK",
        "INVALID",
        "MISSING",
        "OUT_OF_VIEW",
        "OUT_OF_VOLUME",
        "SWITCH_OFF",
        "REQUEST_TIMEOUT",
        "DISABLED",
    ),
    *("NOT_AVAILABLE", "UNKNOWN", "BAD_TRANSFORM_FIT", "DATA_BUFFER_LIMIT", "ALGORITHM_LIMIT", "FELL_BEHIND"),
    *("PROCESSING_ERROR", "NO_SIGNAL", ""),
}
"""Words of PLUS and NDI for a pose or image; all but OK mean that there is none."""


def read_sequence(path: Path | str) -> TrackedSequence:
    """Read a tracked sequence.

    Frames that repeat an earlier time stamp are dropped, and frames out of order by up to REORDERING_S are
    sorted. If time runs back further, the recording ends and no later frame is used: stamps before and
    after belong to two clocks. Frames without a time stamp are left out if most have one. All of this is
    logged. Without time stamps `t_s` is the frame index and `has_timestamps` is False. Without status fields
    a pose counts as OK. A pose whose status is not OK is invalid and its matrix is not checked; so is one
    that is exactly the identity, whatever its status, but for a reference that always is: it is the tracker.
    Transforms from or to pixel frames (ImageToProbe) are image maps, not poses. Images are turned to MF
    (`orientation`).

    Args:
        path: `.igs.mha`, `.igs.mhd`, `.igs.nrrd`, or the same without `.igs`.
    Returns:
        the sequence; matrices keep the digits of the file.
    Raises:
        UnreadableFileError: absent, not a sequence, truncated, not uint8, or with malformed fields.
    """
    return read_indexed_sequence(path)[0]


def read_indexed_sequence(path: Path | str) -> tuple[TrackedSequence, IntArray, int]:
    """Read a sequence, the (n,) indices of its used frames, and the file's frame count."""
    path = Path(path)
    with reading(path, "a tracked sequence"):
        raw = read_raw_sequence(path)
        if raw.columns and raw.image_type not in (_B_MODE, "XX", ""):
            raise UnreadableFileError(
                f"{path}: its images are {raw.image_type}; needed {_B_MODE}: record B-mode"
            )
        return *indexed_sequence(path, raw), raw.frames


def image_orientation(path: Path) -> str | None:
    """Return the orientation of a file's images as they are read; None if unknown, or no sequence."""
    if path.suffix.lower() not in SEQUENCE_SUFFIXES:
        return None
    stored = require_orientation(path, read_raw_sequence(path, pixels=False).orientation)
    return None if stored == UNKNOWN else (turned_orientation(stored) or stored)[:2]


def indexed_sequence(path: Path, raw: RawSequence) -> tuple[TrackedSequence, IntArray]:
    """Interpret a parsed sequence; without its pixels it has no images. See `read_indexed_sequence`."""
    with reading(path, "a tracked sequence"):
        t_s, has_timestamps = _times(path, raw)
        order = _usable_order(path, t_s)
        t_s = t_s[order]
        stored = require_orientation(path, raw.orientation)
        turned = turned_orientation(stored) if raw.columns else None
        status = "ImageStatus" if "ImageStatus" in raw.frame_fields else "Status"  # the second in NRRD files
        sequence = TrackedSequence(
            t_s=t_s,
            images=_images(path, raw, order, stored),
            image_valid=_statuses(path, raw, status)[order],
            poses=_streams(path, raw, t_s, order),
            has_timestamps=has_timestamps,
            orientation=turned or stored,
            turned_from=stored if turned else None,
            image_maps=_image_maps(path, raw, order),
        )
        if has_timestamps and (problem := period_problem(t_s)):
            log.warning("%s has %s", path, problem)
    return sequence, order


def _times(path: Path, raw: RawSequence) -> tuple[FloatArray, bool]:
    """Return (frames,) time stamps, NaN for frames without; the frame index if the file has none."""
    texts, bare = raw.frame_fields.get("Timestamp", {}), raw.bare
    if bare.sum() >= MOST_BARE * raw.frames:
        raise UnreadableFileError(
            f"{path}: {bare.sum()} of {raw.frames} frames have no Timestamp (first: frame {bare.argmax()}); "
            "needed one on every frame or on none"
        )
    if bare.any():
        log.warning(
            f"{path}: {bare.sum()} of {raw.frames} frames have no Timestamp and are left out: "
            f"{_listed(np.flatnonzero(bare).tolist())}"
        )
    try:
        t_s = np.array([float(texts[i]) if texts and not bare[i] else float(i) for i in range(raw.frames)])
    except ValueError as exc:
        raise UnreadableFileError(f"{path}: a Timestamp is not a number ({exc})") from exc
    if not np.isfinite(t_s).all():
        bad = int(np.flatnonzero(~np.isfinite(t_s))[0])
        raise UnreadableFileError(f"{path}: the Timestamp of frame {bad} is not finite; record again")
    limits.require_times(t_s, "a Timestamp")
    return np.where(bare, np.nan, t_s), bool(texts)


def _listed(numbers: list[int]) -> str:
    """List numbers of frames, at most LISTED of them."""
    more = f" and {len(numbers) - LISTED} more" if len(numbers) > LISTED else ""
    return f"frame {', '.join(map(str, numbers[:LISTED]))}{more}"


def _usable_order(path: Path, t_s: FloatArray) -> IntArray:
    """Sort indices of frames with a time, up to a clock restart; keep the first of equal times."""
    stamped = np.flatnonzero(np.isfinite(t_s))
    t_s = t_s[stamped]
    restart = clock_restart(t_s)
    frames = len(t_s) if restart is None else restart
    if restart is not None:
        latest_s = float(t_s[:restart].max())
        log.warning(
            f"{path}: time jumps back by {latest_s - t_s[restart]:.3f} s at frame {stamped[restart]} (from "
            f"{latest_s:.3f} s to {t_s[restart]:.3f} s), as when a clock restarts; the {len(t_s) - restart} "
            "frames from there on are not used: split the file there, or record again"
        )
    order = np.argsort(t_s[:frames], kind="stable")
    unique = order[np.concatenate([[True], np.diff(t_s[order]) > 0])]
    late = int(np.count_nonzero(np.diff(t_s[:frames]) < 0))
    if len(unique) < frames or late:
        log.warning(
            f"{path}: dropped {frames - len(unique)} of {frames} frames that repeat a time stamp; time runs "
            f"backwards at {late} places, sorted"
        )
    return np.asarray(stamped[unique], dtype=np.int64)


def clock_restart(t_s: FloatArray) -> int | None:
    """Return the index of the first frame stamped more than REORDERING_S before an earlier one, or None.

    Args:
        t_s: (frames,) stamps in the order of the file.
    """
    restarts = np.flatnonzero(np.maximum.accumulate(t_s) - t_s > REORDERING_S)
    return int(restarts[0]) if len(restarts) else None


def _images(path: Path, raw: RawSequence, order: IntArray, stored: str) -> NDArray[np.uint8] | None:
    if not len(raw.pixels):
        return None
    images = np.frombuffer(raw.pixels, np.uint8).reshape(raw.frames, raw.rows, raw.columns)
    in_order = len(order) == raw.frames and bool((np.diff(order) > 0).all())
    if turned := turned_orientation(stored):
        log.warning(
            f"{path}: its images are stored as {stored} and were turned to {turned}, in which PLUS calibrates"
        )
    elif stored[0] in "FN":
        log.warning("%s holds lines of the transducer (%s), not scan-converted images", path, stored)
    elif stored == UNKNOWN:
        stated = raw.orientation or "no UltrasoundImageOrientation"
        log.warning("%s does not say how its images are oriented (%s); MF is assumed", path, stated)
    return turned_images(images if in_order else images[order], stored)


def _image_maps(path: Path, raw: RawSequence, order: IntArray) -> dict[str, FloatArray]:
    """Read the recorded (4, 4) transforms from or to pixels by name; warn of one that is not constant."""
    maps: dict[str, FloatArray] = {}
    for field, (target, source) in _transform_fields(raw):
        if target not in PIXEL_FRAMES and source not in PIXEL_FRAMES:
            continue
        matrices, valid = _matrices(path, raw, field)
        matrices = matrices[order][valid[order]]
        if len(matrices) and np.isfinite(matrices[0]).all() and (matrices == matrices[0]).all():
            maps[f"{target}_from_{source}"] = matrices[0]
        else:
            log.warning("%s: %s is not one fixed map of the image and is left out", path, field)
    return maps


def _transform_fields(raw: RawSequence) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield the fields that hold transforms, each with its target and source."""
    for field in sorted(raw.frame_fields):
        frames = split_transform(field.removesuffix("Transform")) if field.endswith("Transform") else None
        if frames is not None:
            yield field, frames


def _statuses(path: Path, raw: RawSequence, name: str) -> BoolArray:
    """Return (frames,) True if the status is OK; one that is absent is OK unless other frames state that."""
    texts = {i: text.upper() for i, text in raw.frame_fields.get(name, {}).items()}
    if unknown := sorted(set(texts.values()) - _STATUSES):
        log.warning("%s: the status '%s' of %s is not known and counts as lost", path, unknown[0][:20], name)
    absent = "" if "OK" in texts.values() else "OK"
    return np.array([texts.get(i, absent) == "OK" for i in range(raw.frames)])


def _streams(path: Path, raw: RawSequence, t_s: FloatArray, order: IntArray) -> dict[str, PoseStream]:
    streams: dict[str, PoseStream] = {}
    for field, (target, source) in _transform_fields(raw):
        if target in PIXEL_FRAMES or source in PIXEL_FRAMES:
            continue
        matrices, valid = _matrices(path, raw, field)
        matrices, valid = matrices[order], valid[order]
        unseen = valid & identities(matrices)
        if unseen.any() and not (source == "reference" and unseen.all()):
            log.warning(
                f"{path}: {field} is exactly the identity in {np.count_nonzero(unseen)} of {len(valid)} "
                "frames, as programs write a pose that was not tracked, though its status is OK; these "
                "poses count as lost"
            )
            valid &= ~unseen
        stream = PoseStream(target, source, t_s, matrices[:, :3, :3], matrices[:, :3, 3], valid)
        streams[stream.name] = stream
    return streams


def _matrices(path: Path, raw: RawSequence, field: str) -> tuple[FloatArray, BoolArray]:
    """Parse (frames, 4, 4) matrices (NaN if absent or malformed and not OK) and (frames,) validity."""
    texts = raw.frame_fields[field]
    valid = _statuses(path, raw, f"{field}Status") & np.array([i in texts for i in range(raw.frames)])
    flat = np.full((raw.frames, 16), np.nan)
    for i, text in texts.items():
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
    translations = matrices[valid]
    limits.require_lengths(translations[np.isfinite(translations)], field)
    if (np.abs(matrices[valid][:, 3] - (0, 0, 0, 1)) > 1e-9).any():
        raise UnreadableFileError(f"{path}: {field} has a last row other than 0 0 0 1")
    return matrices, valid
