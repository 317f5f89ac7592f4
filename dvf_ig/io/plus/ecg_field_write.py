"""Write an ECG into a PLUS sequence file in the format of `ecg_field`."""

import re
from pathlib import Path

import numpy as np

from dvf_ig.core.errors import InvalidInputError
from dvf_ig.core.recordings.signal import Signal
from dvf_ig.io.reading import read_bytes
from dvf_ig.io.writing.atomic import write_bytes

from .raw_sequence import read_raw_sequence

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
