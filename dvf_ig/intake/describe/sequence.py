"""Summarise tracked sequences and pose streams for `describe`: clocks, validity, and the frame tree."""

from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, Signal, TrackedSequence, UnreadableFileError
from dvf_ig.core.plausible import marker_problem
from dvf_ig.core.recordings.stream import MAX_GAP_S, PoseStream
from dvf_ig.io.plus.ecg_field import ecg_fields, ecg_of_sequence
from dvf_ig.io.plus.numeric_fields import numeric_fields
from dvf_ig.io.plus.raw_sequence import RawSequence, read_raw_sequence
from dvf_ig.io.plus.sequence_read import clock_restart, indexed_sequence, read_sequence

FROZEN_SAMPLES = 5
"""A pose that repeats bit for bit this often is counted as frozen: a live tracker always shows noise."""

Facts = dict[str, Any]


def sequence_file_facts(path: Path) -> Facts:
    """Summarise a tracked sequence file with pixels of any type; read 8-bit images in full, to check them."""
    raw = read_raw_sequence(path, pixels=False)
    sequence = read_sequence(path) if raw.is_uint8 else indexed_sequence(path, raw)[0]
    size = [raw.columns, raw.rows] if raw.columns else None
    facts = sequence_facts(sequence)
    return {
        **facts,
        "frames_left_out": int(raw.bare.sum()),
        "image_size_px": size,
        "orientation": raw.orientation or sequence.orientation,
        "turned_to": sequence.orientation if sequence.turned_from else None,
        "pixel_type": raw.pixel_type if size else None,
        "invalid_image_share": None if size is None else 1.0 - float(sequence.image_valid.mean()),
        **_stamp_facts(raw),
        "image_maps": sorted(sequence.image_maps),
        "frame_tree": frame_tree(
            [*((one.target, one.source) for one in sequence.poses.values()), *map(_pair, sequence.image_maps)]
        ),
        "numeric_fields": list(numeric_fields(raw)),
        "ecg": {name: _ecg_facts(path, raw, name) for name in ecg_fields(raw)},
    }


def _ecg_facts(path: Path, raw: RawSequence, field: str) -> Facts:
    """Summarise the ECG in a field, or report why it cannot be used."""
    try:
        signal = ecg_of_sequence(path, raw, field)
    except UnreadableFileError as exc:
        return {"problem": str(exc)}
    return signal_facts(signal)


def signal_facts(signal: Signal) -> Facts:
    """Summarise leads, rate, length and missing samples of an ECG."""
    return {
        "leads": list(signal.leads),
        **({"left_out": list(signal.left_out)} if signal.left_out else {}),
        "unit": signal.unit,
        "rate_hz": signal.rate_hz,
        "samples": len(signal),
        "start_s": signal.start_s,
        "duration_s": len(signal) / signal.rate_hz,
        "missing_share": float(np.isnan(signal.samples).mean()),
        "peak_to_peak": [_peak_to_peak(lead) for lead in signal.samples.T],
    }


def _peak_to_peak(lead: FloatArray) -> float | None:
    """Range of the delivered samples, or None if there are none."""
    delivered = lead[np.isfinite(lead)]
    return float(np.ptp(delivered)) if len(delivered) else None


def sequence_facts(sequence: TrackedSequence) -> Facts:
    """Summarise frames, images, clock and transforms of a tracked sequence."""
    images = sequence.images
    return {
        "frames": len(sequence),
        "image_size_px": None if images is None else [images.shape[2], images.shape[1]],
        "orientation": sequence.orientation,
        "invalid_image_share": None if images is None else 1.0 - float(sequence.image_valid.mean()),
        "has_timestamps": sequence.has_timestamps,
        **clock_facts(sequence.t_s if sequence.has_timestamps else None),
        "transforms": {name: stream_facts(stream) for name, stream in sequence.poses.items()},
    }


def clock_facts(t_s: FloatArray | None) -> Facts:
    """Start, length, rate, irregularity and gaps of increasing time stamps; None if there are none.

    `jitter_s` is the standard deviation of the steps between frames without a gap;
    `missing_frames` is the number of frames that would have fitted into the longer steps.
    """
    if t_s is None or len(t_s) < 2:
        names = ("start_s", "duration_s", "rate_hz", "jitter_s", "missing_frames", "gaps", "longest_gap_s")
        return dict.fromkeys(names)
    steps = np.diff(t_s)
    usual = float(np.median(steps))
    return {
        "start_s": float(t_s[0]),
        "duration_s": float(t_s[-1] - t_s[0]),
        "rate_hz": 1 / usual,
        "jitter_s": float(steps[steps < 1.5 * usual].std()),
        "missing_frames": int((np.maximum(1, np.round(steps / usual)) - 1).sum()),
        "gaps": int(np.count_nonzero(steps > MAX_GAP_S)),
        "longest_gap_s": float(steps.max()),
    }


def stream_facts(stream: PoseStream) -> Facts:
    """Summarise validity, the bitwise frozen share, and the motion and turn of a tracked object."""
    usable = stream.valid
    problem = marker_problem(stream.name, stream.translations_mm[usable])
    facts: Facts = {"samples": len(stream), "invalid_share": float((~usable).mean()), "problem": problem}
    if not usable.any():
        return {**facts, "frozen_share": 0.0, "extent_mm": None, "turn_deg": None}
    flat = np.column_stack([stream.rotations.reshape(-1, 9), stream.translations_mm])[usable]
    rotations = stream.rotations[usable]
    cosine = (np.einsum("ij,nij->n", rotations[0], rotations) - 1) / 2
    return {
        **facts,
        "frozen_share": _frozen_share(np.append(False, (np.diff(flat, axis=0) == 0).all(axis=1))),
        "extent_mm": np.ptp(stream.translations_mm[usable], axis=0).tolist(),
        "turn_deg": float(np.degrees(np.arccos(np.clip(cosine, -1, 1)).max())),
    }


def frame_tree(edges: list[tuple[str, str]]) -> list[str]:
    """Draw which frames are connected, as lines of a text tree; one tree per connected group.

    The frame with most connections is the root of its group; connections that close a ring are omitted.

    Args:
        edges: (target, source) of each transform.
    """
    near: dict[str, list[str]] = {}
    for target, source in edges:
        near.setdefault(target, []).append(source)
        near.setdefault(source, []).append(target)
    lines: list[str] = []
    seen: set[str] = set()
    for root in sorted(near, key=lambda frame: -len(near[frame])):
        if root not in seen:
            seen.add(root)
            lines += [root, *_branches(root, near, seen, "")]
    return lines


def _branches(frame: str, near: dict[str, list[str]], seen: set[str], indent: str) -> list[str]:
    children = [child for child in dict.fromkeys(near[frame]) if child not in seen]
    seen.update(children)
    lines = []
    for child in children:
        last = child == children[-1]
        lines.append(f"{indent}{'└─ ' if last else '├─ '}{child}")
        lines += _branches(child, near, seen, indent + ("   " if last else "│  "))
    return lines


def _pair(name: str) -> tuple[str, str]:
    target, _, source = name.partition("_from_")
    return target, source


def _stamp_facts(raw: RawSequence) -> Facts:
    """How the file gives the stamps: repeats, steps back, how far the recorder's filter moved them, and
    where the clock restarted: frame, its stamp, size of the jump, and how many frames are not used for it.
    """
    stamps, plain = raw.numbers("Timestamp"), raw.numbers("UnfilteredTimestamp")
    if stamps is None:
        names = ("repeated_stamps", "backward_stamps", "stamp_filter_shift_s", "clock_restart")
        return dict.fromkeys(names)
    used = np.flatnonzero(np.isfinite(stamps))
    stamps = stamps[used]
    steps, restart = np.diff(stamps), clock_restart(stamps)
    return {
        "repeated_stamps": int(np.count_nonzero(steps == 0)),
        "backward_stamps": int(np.count_nonzero(steps < 0)),
        "stamp_filter_shift_s": None if plain is None else float(np.nanmax(np.abs(stamps - plain[used]))),
        "clock_restart": None
        if restart is None
        else {
            "frame": int(used[restart]),
            "at_s": float(stamps[restart]),
            "back_s": float(stamps[:restart].max() - stamps[restart]),
            "unused_frames": len(used) - restart,
        },
    }


def _frozen_share(repeats: BoolArray) -> float:
    """Share of samples in runs of at least FROZEN_SAMPLES equal ones; `repeats[i]`: equals sample i − 1."""
    starts = np.flatnonzero(~repeats)
    lengths = np.diff(np.append(starts, len(repeats)))
    return float(lengths[lengths >= FROZEN_SAMPLES].sum() / len(repeats))
