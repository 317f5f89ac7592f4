"""The header of a WFDB record, checked before the package wfdb reads the samples.

Source: WFDB header(5): a record line "name[/segments] signals rate samples …", then a line for each signal
"file format gain …", or for each segment "name samples".
"""

import logging
import math
import re
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.io import limits
from dvf_ig.io.file_within import file_within
from dvf_ig.io.reading import read_text

MOST_LEADS = 512
MOST_GAPS = 100
"""A record of segments states at most so many times the samples that these hold."""
_BYTES = {
    "8": Fraction(1),
    "16": Fraction(2),
    "24": Fraction(3),
    "32": Fraction(4),
    "61": Fraction(2),
    "80": Fraction(1),
    "160": Fraction(2),
    "212": Fraction(3, 2),
    "310": Fraction(4, 3),
    "311": Fraction(4, 3),
    "508": None,
    "516": None,
    "524": None,
}
"""Of a sample by format; None where it is compressed."""
_NUMBER = r"\d{1,6}(?:\.\d{1,12})?"
_RECORD = re.compile(
    rf"(\S+?)(?:/(\d{{1,5}}))?(?:\s+(\d{{1,4}}))(?:\s+({_NUMBER})(?:/\S+)?(?:\s+(\d{{1,12}})\b.*)?)?"
)
_GAIN = r"-?(?:\d{1,20}\.?\d{0,20}|\.\d{1,20})(?:e[-+]?\d{1,3})?"
_SIGNAL = re.compile(
    r"(\S+)\s+(\d{1,3})(?:x(\d{1,4}))?(?::(\d{1,9}))?(?:\+(\d{1,9}))?"
    rf"(?:\s+({_GAIN})(?:\(-?\d{{1,10}}\))?(?:/\S*)?(?:\s.*)?)?"
)
"""File, format, samples in a frame, skew in frames, offset in bytes, gain."""
_SEGMENT = re.compile(r"(\S+)\s+(\d{1,12})")

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RecordHeader:
    """What of a record's header decides how it is read.

    Attributes:
        files: the header, then the files that it names, in order.
        rate_hz: as stated.
        stated: samples of each lead; None where the header does not say.
        held: whole samples of each lead in the files; None where these are compressed, or of segments.
    """

    files: tuple[Path, ...]
    rate_hz: float
    stated: int | None
    held: int | None


def read_record_header(record: Path) -> RecordHeader:
    """Check and parse the header of a record, named without suffix.

    Raises:
        UnreadableFileError: absent, not a header, files that are not in its folder, or more than an ECG has.
    """
    header = record.with_name(f"{record.name}.hea")
    line, lines = _record_line(header)
    rate_hz, leads = float(line[4] or 250.0), int(line[3])
    stated = int(line[5]) if line[5] else None
    count = int(line[2]) if line[2] else leads
    if len(lines) != count:
        raise UnreadableFileError(f"{header} has lines of {len(lines)} of {count} signals; copy it again")
    if line[2]:
        files = _of_segments(header, lines, rate_hz, stated)
        limits.require_count((stated or 0) * leads, limits.SAMPLES, "samples")
        return RecordHeader((header, *files), rate_hz, stated, None)
    files, held = _of_signals(header, lines, stated)
    return RecordHeader((header, *files), rate_hz, stated, held)


def read_rate_and_length(record: Path) -> tuple[float, int | None]:
    """Samples a second and samples of each lead, as the header of a record says; no other file is looked for.

    Raises:
        UnreadableFileError: absent, or not a header.
    """
    line, _ = _record_line(record.with_name(f"{record.name}.hea"))
    return float(line[4] or 250.0), int(line[5]) if line[5] else None


def _record_line(header: Path) -> tuple[re.Match[str], list[str]]:
    """The record line taken apart, within what an ECG can be, and the lines after it."""
    text = read_text(header, "a WFDB header", limits.SETTINGS_BYTES)
    lines = [line.strip() for line in text.splitlines() if line.strip() and line.lstrip()[0] != "#"]
    found = _RECORD.fullmatch(lines[0]) if lines else None
    if found is None:
        shown = lines[0][:60] if lines else "empty"
        raise UnreadableFileError(
            f"{header}: not a readable WFDB header, its record line is '{shown}'; copy it again"
        )
    rate_hz, leads = float(found[4] or 250.0), int(found[3])
    if not 0 < rate_hz <= 1e5 or not 1 <= leads <= MOST_LEADS:
        raise UnreadableFileError(f"{header} states {leads} leads at {rate_hz:g} Hz; copy it again")
    limits.require_count(int(found[5] or 0) * leads, limits.SAMPLES, "samples")
    return found, lines[1:]


def _of_segments(header: Path, lines: list[str], rate_hz: float, stated: int | None) -> tuple[Path, ...]:
    """The files of every segment, which has a header of its own."""
    segments = [_SEGMENT.fullmatch(line) for line in lines]
    if not all(segments):
        shown = next(line for line, found in zip(lines, segments, strict=True) if found is None)
        raise UnreadableFileError(f"{header}: the line of a segment is '{shown[:60]}'; copy it again")
    lengths = {found[1]: int(found[2]) for found in segments if found is not None}
    total = sum(int(found[2]) for found in segments if found is not None)
    if stated is not None and total != stated:
        raise UnreadableFileError(f"{header} states {stated} samples, its segments {total}; copy it again")
    limits.require_count(total, limits.SAMPLES, "samples")
    held = total - sum(int(found[2]) for found in segments if found is not None and found[1] == "~")
    if total > MOST_GAPS * held:
        raise UnreadableFileError(
            f"{header} states {total} samples, of which its segments hold {held}; copy it again"
        )
    files: list[Path] = []
    for segment, length in lengths.items():
        if segment == "~":
            continue
        own = file_within(header.parent, f"{segment}.hea", header)
        line, signals = _record_line(own)
        if line[2]:
            raise UnreadableFileError(f"{header}: its segment '{segment}' has segments itself; copy it again")
        if line[4] is not None and float(line[4]) != rate_hz:
            raise UnreadableFileError(
                f"{own} states {float(line[4]):g} Hz, its record {rate_hz:g} Hz; resample it to one rate"
            )
        if line[5] is not None and int(line[5]) != length:
            raise UnreadableFileError(
                f"{own} states {line[5]} samples, its record {length} of it; copy it again"
            )
        if any(signal.split()[0] == "~" for signal in signals):
            files.append(own)  # the layout of a record whose leads vary: no samples
            continue
        files += read_record_header(own.with_suffix("")).files
    return tuple(files)


def _of_signals(header: Path, lines: list[str], stated: int | None) -> tuple[tuple[Path, ...], int | None]:
    """The signal files in order, and whole samples of each lead that all of them hold."""
    frames: dict[Path, Fraction | None] = {}
    offsets: dict[Path, int] = {}
    uncalibrated: list[int] = []
    each, skew = 0, 0
    for number, line in enumerate(lines):
        found = _SIGNAL.fullmatch(line)
        if found is None or found[2] not in _BYTES or (count := int(found[3] or 1)) < 1:
            raise UnreadableFileError(f"{header}: the line of a signal is '{line[:60]}'; copy it again")
        path, size = file_within(header.parent, found[1], header), _BYTES[found[2]]
        before = frames.get(path, Fraction(0))
        frames[path] = None if size is None or before is None else before + size * count
        offsets[path] = int(found[5] or 0)
        each, skew = each + count, max(skew, int(found[4] or 0))
        gain = float(found[6] or 0.0)
        if not math.isfinite(gain):
            raise UnreadableFileError(f"{header}: the gain of a signal is {found[6]}; copy it again")
        if gain == 0.0:
            uncalibrated.append(number)
    held = [
        None if frame is None else max(int((path.stat().st_size - offsets[path]) / frame), 0)
        for path, frame in frames.items()
    ]
    known = [count for count in held if count is not None]
    length = min(known, default=0) if stated is None else stated
    limits.require_count(length * each, limits.SAMPLES, "samples")
    if skew and skew >= length:
        raise UnreadableFileError(
            f"{header}: a signal of {length} samples begins {skew} samples late; copy it again"
        )
    if uncalibrated:
        log.warning(
            "%s states no gain of signal %s: 200 units in a mV are taken, as WFDB says; its times are right, "
            "its amplitude was not calibrated",
            header,
            ", ".join(map(str, uncalibrated)),
        )
    return tuple(frames), min(known) if len(known) == len(held) else None
