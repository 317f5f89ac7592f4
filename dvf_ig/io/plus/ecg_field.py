"""Read and write an ECG inside a PLUS sequence: a per-frame field of samples since the previous frame.

PLUS stores each line that a GenericSerialDevice sends as one item, under the Id of its data source, stamped
when it arrived; a recorded frame gets the item nearest in time, and that item's time as its Timestamp
(vtkPlusGenericSerialDevice::ReceiveResponse, vtkPlusChannel::GetTrackedFrame). So most lines that arrive
faster than frames are lost, and a line that arrives slower may occur in two frames; the times of single
samples are not recorded. These optional fields are read in addition to `<Name>`:

    Seq_FrameNNNN_<Name>Timestamp   time of the frame's first sample (s)
    Seq_FrameNNNN_<Name>Status      anything but OK: the frame's samples are missing
    <Name>Rate                      samples per second
    <Name>Leads                     names of leads, separated by blanks; samples alternate between leads
    <Name>Unit                      for example mV

With times and rate the sample times are exact; otherwise `batch_times` estimates them.
"""

import logging
import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, IntArray, Signal, read_only_arrays
from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.io.reading import read_bytes, reading
from dvf_ig.io.writing.atomic import write_bytes

from .batch_times import fit_batch_times
from .numeric_fields import numbers_of, numeric_fields
from .raw_sequence import RawSequence, read_raw_sequence
from .sequence_read import clock_restart

log = logging.getLogger(__name__)

SLOWEST_HZ = 100.0
"""Lowest sampling rate at which R peaks are detected."""
UNKNOWN_UNIT = "unknown"
OFF_RASTER = 0.25
"""Largest distance, in samples, of recorded times from an even raster; beyond it their clock drifts."""
_LONGEST_GAP = 20
"""Largest ratio of the raster's length to the number of samples; beyond it a time is wrong."""


def read_ecg_field(path: Path | str, name: str | None = None) -> Signal:
    """Read the ECG in a tracked sequence, on the clock of its time stamps.

    Args:
        path: the sequence, with or without images.
        name: of the field; None uses the only one whose name contains "ecg".
    Returns:
        the samples, NaN for missing frames or values. Lines that PLUS repeated count once.
    Raises:
        UnreadableFileError: not a sequence; no such field, or several; values that are not numbers; times
            that contradict each other; slower than SLOWEST_HZ.
    """
    path = Path(path)
    with reading(path, "a tracked sequence with an ECG"):
        return ecg_of_sequence(path, read_raw_sequence(path, pixels=False), name)


def ecg_of_sequence(path: Path, raw: RawSequence, name: str | None = None) -> Signal:
    """Read the ECG in a parsed sequence; see `read_ecg_field`."""
    field = name if name is not None else _only_ecg_field(path, raw)
    if field not in raw.frame_fields:
        raise UnreadableFileError(f"{path} has no field '{field}'; {_listed(raw)}")
    leads = tuple((_companion(raw, field, "Leads") or field).split())
    batches = _batches(path, raw, field, len(leads))
    stated = _companion(raw, field, "Rate")
    try:
        rate_hz = None if stated is None else float(stated)
    except ValueError as exc:
        raise UnreadableFileError(f"{path}: {field}Rate is '{stated}'; needed samples per second") from exc
    times = _raster(path, field, batches, rate_hz)
    if times.rate_hz < SLOWEST_HZ:
        raise UnreadableFileError(
            f"{path}: field {field} has {times.rate_hz:.3g} samples per second; needed {SLOWEST_HZ:g}: "
            "PLUS keeps one line per frame; send several values per line, or record the "
            "ECG separately"
        )
    samples = _on_raster(path, field, batches, times)
    unit = _companion(raw, field, "Unit") or UNKNOWN_UNIT
    return Signal(samples, times.rate_hz, times.start_s, leads, unit)


def ecg_fields(raw: RawSequence) -> tuple[str, ...]:
    """List the numeric fields whose names contain "ecg"."""
    return tuple(name for name in numeric_fields(raw) if "ecg" in name.lower())


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Batches:
    """Samples of each frame, concatenated in order of time.

    Attributes:
        counts: (b,) samples per batch, at least 1.
        stamps_s: (b,) time stamps of the frames; NaN if the file has none.
        first_s: (b,) times of the first samples; None if they were not recorded.
        values: (n, leads).
    """

    counts: IntArray
    stamps_s: FloatArray
    first_s: FloatArray | None
    values: FloatArray


class _Raster(NamedTuple):
    """Even sampling: its rate, the time of sample 0, and (b,) the index of each batch's first sample."""

    rate_hz: float
    start_s: float
    first: IntArray


def _only_ecg_field(path: Path, raw: RawSequence) -> str:
    fields = ecg_fields(raw)
    if len(fields) == 1:
        return fields[0]
    number = f"{len(fields)} fields of an ECG" if fields else "no field whose name contains 'ecg'"
    raise UnreadableFileError(f"{path} has {number}; {_listed(raw)}")


def _listed(raw: RawSequence) -> str:
    names = numeric_fields(raw)
    if not names:
        return "it has no numeric fields: give the ECG as a file"
    return f"give the ECG as a file, or name a numeric field as plus:FILE#FIELD: {', '.join(names)}"


def _companion(raw: RawSequence, field: str, what: str) -> str | None:
    """Read a field that describes another, from the sequence or from its first frame that has it."""
    name = f"{field}{what}"
    return raw.fields.get(name) or next(iter(raw.frame_fields.get(name, {}).values()), None)


def _batches(path: Path, raw: RawSequence, field: str, leads: int) -> _Batches:
    numbers = numbers_of(path, raw, field)
    texts = raw.frame_fields[field]
    stamps = raw.numbers("Timestamp")
    stamps = np.full(raw.frames, np.nan) if stamps is None else stamps
    first_s = _first_times(path, raw, field)
    frames = np.array(sorted(numbers), dtype=np.int64)
    if not len(frames):
        raise UnreadableFileError(f"{path}: field {field} holds no numbers")
    times = stamps if first_s is None else first_s
    if not np.isfinite(times[frames]).all():
        raise UnreadableFileError(
            f"{path}: frames with {field} have no time stamp; needed Timestamp or {field}Timestamp with each"
        )
    restart = clock_restart(times[frames])
    if restart is not None:
        log.warning("%s: the ECG is used up to frame %d, where its clock restarts", path, frames[restart])
        frames = frames[:restart]
    frames = frames[np.argsort(times[frames], kind="stable")]
    frames = frames[~_repeated(times[frames], [texts[i] for i in frames.tolist()], by_text=first_s is None)]
    uneven = [i for i in frames.tolist() if len(numbers[i]) % leads]
    if uneven:
        raise UnreadableFileError(
            f"{path}: {field} of frame {uneven[0]} has {len(numbers[uneven[0]])} values; "
            f"needed a multiple of its {leads} leads"
        )
    values = np.concatenate([numbers[i] for i in frames.tolist()]).reshape(-1, leads)
    counts = np.array([len(numbers[i]) // leads for i in frames.tolist()], dtype=np.int64)
    return _Batches(counts, stamps[frames], None if first_s is None else first_s[frames], values)


def _first_times(path: Path, raw: RawSequence, field: str) -> FloatArray | None:
    """Read (frames,) recorded times of first samples, NaN if missing; None without that field."""
    texts = raw.frame_fields.get(f"{field}Timestamp")
    if not texts:
        return None
    try:
        return np.array([float(texts.get(i) or "nan") for i in range(raw.frames)])
    except ValueError as exc:
        raise UnreadableFileError(f"{path}: a {field}Timestamp is not a number ({exc})") from exc


def _repeated(times_s: FloatArray, texts: list[str], *, by_text: bool) -> BoolArray:
    """Mark (b,) frames that PLUS gave the same line as the frame before.

    The times are equal; or, with `by_text`, several differing values are equal (a single value or a flat line
    may repeat by chance).
    """
    again = [False]
    for i in range(1, len(texts)):
        values = re.split(r"[\s,;]+", texts[i].strip())
        same_line = texts[i] == texts[i - 1] and len(values) >= 3 and len(set(values)) > 1
        again.append(bool(times_s[i] == times_s[i - 1]) or (by_text and same_line))
    return np.array(again)


def _raster(path: Path, field: str, batches: _Batches, stated_hz: float | None) -> _Raster:
    """Locate the batches by their recorded times or by their time stamps."""
    if batches.first_s is not None and stated_hz is not None:
        exact = _recorded(batches.counts, batches.first_s, stated_hz)
        if exact is not None:
            return exact
    counts, first_s = batches.counts, batches.first_s
    try:
        if first_s is None:
            times = fit_batch_times(counts, batches.stamps_s)
            first = times.last + 1 - counts
        else:
            times = fit_batch_times(
                np.append(1, counts[:-1]), first_s
            )  # treats each first sample as the last one of its batch
            first = times.last
    except InvalidInputError as exc:
        raise UnreadableFileError(f"{path}, field {field}: {exc}") from exc
    if stated_hz is not None and abs(stated_hz - times.rate_hz) > 0.02 * times.rate_hz:
        raise UnreadableFileError(
            f"{path}: {field}Rate is {stated_hz:g} Hz, but {times.rate_hz:.4g} Hz was recorded"
        )
    log.warning(
        f"{path}: the ECG times in field {field} are estimated from the time stamps of {len(counts)} "
        f"frames: {times.rate_hz:.5g} Hz from {times.start_s:.3f} s, accurate to about "
        f"{max(1.0, 1000 * times.spread_s):.0f} ms"
    )
    return _Raster(times.rate_hz, times.start_s, first)


def _recorded(counts: IntArray, first_s: FloatArray, rate_hz: float) -> _Raster | None:
    """Build the raster from times and rate; None if batches would overlap or lie between samples."""
    position = (first_s - first_s[0]) * rate_hz
    if not (np.abs(position) < 2.0**53).all():  # beyond it float64 does not hold whole numbers exactly
        return None
    first = np.rint(position).astype(np.int64)
    fits = np.abs(position - first).max() < OFF_RASTER and (np.diff(first) >= counts[:-1]).all()
    return _Raster(rate_hz, float(first_s[0]), first) if fits else None


def _on_raster(path: Path, field: str, batches: _Batches, times: _Raster) -> FloatArray:
    """Place (n, leads) samples on the even raster, NaN between batches with a gap."""
    length = int(times.first[-1] + batches.counts[-1])
    if length > _LONGEST_GAP * len(batches.values):
        raise UnreadableFileError(
            f"{path}: the times of field {field} span {length / times.rate_hz:.0f} s, but its "
            f"{len(batches.values)} samples fill {len(batches.values) / times.rate_hz:.0f} s"
        )
    begins = np.cumsum(batches.counts) - batches.counts
    at = np.repeat(times.first - begins, batches.counts) + np.arange(len(batches.values))
    samples = np.full((length, batches.values.shape[1]), np.nan)
    samples[at] = batches.values
    missing = length - len(batches.values)
    if missing:
        gaps = int(np.count_nonzero(np.diff(times.first) > batches.counts[:-1]))
        log.warning("%s: field %s lacks %d samples at %d places", path, field, missing, gaps)
    return samples


_DATA_FILE_LINE = re.compile(rb"^ElementDataFile[ \t]*=", re.MULTILINE)
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*")


def add_ecg_field(sequence: Path | str, signal: Signal, path: Path | str, *, name: str = "EcgData") -> None:
    """Write a copy of a sequence in which every frame also holds the ECG since the frame before.

    The first frame also holds the samples before it, the last those after it. Rate, leads, unit and the time
    of each frame's first sample are also written, so that reading gives the same samples, rate and start,
    digit for digit. PLUS itself truncates header lines after 999 characters.

    Args:
        sequence: an existing .mha with a Timestamp on every frame, on any clock.
        signal: its times are written unchanged; they need not be on the clock of the frames.
        path: of the copy; may be the same file.
        name: of the field.
    Raises:
        UnreadableFileError: `sequence` is not a sequence metafile.
        InvalidInputError: it has no time stamps, or already has the field; a name that is not valid in PLUS.
        OutputError: not writable.
    """
    sequence = Path(sequence)
    raw = read_raw_sequence(sequence, pixels=False)
    stamps_s = raw.numbers("Timestamp")
    data = read_bytes(sequence, "a tracked sequence")
    place = _DATA_FILE_LINE.search(data)
    if stamps_s is None or place is None or not np.isfinite(stamps_s).all():
        raise InvalidInputError(
            f"{sequence} is not an .mha with a time stamp on every frame; needed to place the ECG"
        )
    bad = [word for word in (name, *signal.leads) if not _NAME.fullmatch(word)]
    if bad or name in raw.frame_fields:
        raise InvalidInputError(
            f"an ECG field '{name}' of leads {', '.join(signal.leads)} cannot be added to {sequence}; needed "
            "names of letters and digits, and a field that it does not have yet"
        )
    lines = [
        f"{name}Rate = {signal.rate_hz!r}",
        f"{name}Leads = {' '.join(signal.leads)}",
        f"{name}Unit = {signal.unit}",
    ]
    order = np.argsort(stamps_s, kind="stable")
    bounds = np.searchsorted(signal.t_s, stamps_s[order], side="right")
    bounds[-1] = len(signal)
    width = max(4, len(str(raw.frames - 1)))
    times_s, first = signal.t_s.tolist(), 0
    for frame, last in zip(order.tolist(), bounds.tolist(), strict=True):
        if last > first:
            values = " ".join(map(repr, signal.samples[first:last].ravel().tolist()))
            lines.append(f"Seq_Frame{frame:0{width}d}_{name} = {values}")
            lines.append(f"Seq_Frame{frame:0{width}d}_{name}Timestamp = {times_s[first]!r}")
        first = last
    added = ("\n".join(lines) + "\n").encode()
    write_bytes(Path(path), [data[: place.start()], added, data[place.start() :]])
