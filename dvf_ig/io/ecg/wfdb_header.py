"""Check the header of a WFDB record before the package wfdb reads the samples.

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
"""Largest ratio of the samples that a record of segments states to those that its segments hold."""
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
"""Bytes per sample by format; None if compressed."""
_NUMBER = r"\d{1,6}(?:\.\d{1,12})?"
_RECORD = re.compile(
    rf"(\S+?)(?:/(\d{{1,5}}))?(?:\s+(\d{{1,4}}))(?:\s+({_NUMBER})(?:/\S+)?(?:\s+(\d{{1,12}})\b(.*))?)?"
)
_NAME = re.compile(r"[-\w]+", re.ASCII)
_TIME_AND_DATE = re.compile(r"(\s+\d{1,2}(:\d{1,2}){0,2}(\.\d{1,6})?(\s+\d{1,2}/\d{1,2}/\d{4})?)?\s*")
"""Fields of a record line after the number of samples."""
_GAIN = r"-?(?:\d{1,20}\.?\d{0,20}|\.\d{1,20})(?:e[-+]?\d{1,3})?"
_SIGNAL = re.compile(
    r"(\S+)\s+(\d{1,3})(?:x(\d{1,4}))?(?::(\d{1,9}))?(?:\+(\d{1,9}))?"
    rf"(?:\s+({_GAIN})(?:\(-?\d{{1,10}}\))?(?:/\S*)?(?:\s.*)?)?"
)
"""Fields of a signal line: file, format, samples per frame, skew in frames, offset in bytes, gain."""
_SEGMENT = re.compile(r"(\S+)\s+(\d{1,12})")

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RecordHeader:
    """Fields of a record's header that decide how it is read.

    Attributes:
        files: the header, then the files that it names, in order.
        rate_hz: frames per second, by default 250 (WFDB header(5)).
        rate_stated: whether the header states them.
        stated: frames; None if the header does not state it.
        available: complete frames in the files; None for compressed files or segments.
    """

    files: tuple[Path, ...]
    rate_hz: float
    rate_stated: bool
    stated: int | None
    available: int | None


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
        return RecordHeader((header, *files), rate_hz, line[4] is not None, stated, None)
    files, available = _of_signals(header, lines, stated)
    return RecordHeader((header, *files), rate_hz, line[4] is not None, stated, available)


def read_rate_and_length(record: Path) -> tuple[float, int | None]:
    """Read samples per second and samples per lead from a record's header alone.

    Raises:
        UnreadableFileError: absent, or not a header.
    """
    line, _ = _record_line(record.with_name(f"{record.name}.hea"))
    return float(line[4] or 250.0), int(line[5]) if line[5] else None


def simplified(header: Path) -> str | None:
    """Return a header in the strict form that the package wfdb parses; None if it already has it.

    The challenges of 2020 and 2021 name the record "E1.mat" and end its line with "05-May-2020 09:49:17".
    """
    line, lines = _record_line(header)
    strict = _TIME_AND_DATE.fullmatch(line[6] or "") is not None
    if strict and _NAME.fullmatch(line[1]):
        return None
    if not strict:
        log.warning("%s: '%s' is not a time and date of WFDB; it is left out", header, line[6].strip()[:40])
    name, end = re.sub(r"[^-a-zA-Z0-9_]", "_", line[1]), line.end() if strict else line.start(6)
    return "\n".join([f"{name}{line[0][line.end(1) : end]}", *lines, ""])


def _record_line(header: Path) -> tuple[re.Match[str], list[str]]:
    """Parse the record line, check its limits, and return the lines after it."""
    text = read_text(header, "a WFDB header", limits.SETTINGS_BYTES)
    lines = [line.strip() for line in text.splitlines() if line.strip() and line.lstrip()[0] != "#"]
    match = _RECORD.fullmatch(lines[0]) if lines else None
    if match is None:
        shown = lines[0][:60] if lines else "empty"
        raise UnreadableFileError(
            f"{header}: not a readable WFDB header, its record line is '{shown}'; copy it again"
        )
    rate_hz, leads = float(match[4] or 250.0), int(match[3])
    if not 0 < rate_hz <= 1e5 or not 1 <= leads <= MOST_LEADS:
        raise UnreadableFileError(f"{header} states {leads} leads at {rate_hz:g} Hz; copy it again")
    limits.require_count(int(match[5] or 0) * leads, limits.SAMPLES, "samples")
    return match, lines[1:]


def _of_segments(header: Path, lines: list[str], rate_hz: float, stated: int | None) -> tuple[Path, ...]:
    """List the files of every segment, each of which has its own header."""
    segments = [_SEGMENT.fullmatch(line) for line in lines]
    if not all(segments):
        shown = next(line for line, match in zip(lines, segments, strict=True) if match is None)
        raise UnreadableFileError(f"{header}: the line of a segment is '{shown[:60]}'; copy it again")
    lengths = {match[1]: int(match[2]) for match in segments if match is not None}
    total = sum(int(match[2]) for match in segments if match is not None)
    if stated is not None and total != stated:
        raise UnreadableFileError(f"{header} states {stated} samples, its segments {total}; copy it again")
    limits.require_count(total, limits.SAMPLES, "samples")
    present = total - sum(int(match[2]) for match in segments if match is not None and match[1] == "~")
    if total > MOST_GAPS * present:
        raise UnreadableFileError(
            f"{header} states {total} samples, but its segments hold {present}; copy it again"
        )
    if "~" in lengths and not any(match is not None and match[2] == "0" for match in segments[:1]):
        raise UnreadableFileError(
            f"{header} has a gap ('~') and no layout segment, which states the leads during a gap (WFDB "
            "header(5)); add one, or give its segments one by one"
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
    """List the signal files in order, and count the complete samples per lead in all of them."""
    frames: dict[Path, Fraction | None] = {}
    offsets: dict[Path, int] = {}
    uncalibrated: list[int] = []
    each, skew = 0, 0
    for number, line in enumerate(lines):
        match = _SIGNAL.fullmatch(line)
        if match is None or match[2] not in _BYTES or (count := int(match[3] or 1)) < 1:
            raise UnreadableFileError(f"{header}: the line of a signal is '{line[:60]}'; copy it again")
        path, size = file_within(header.parent, match[1], header), _BYTES[match[2]]
        before = frames.get(path, Fraction(0))
        frames[path] = None if size is None or before is None else before + size * count
        offsets[path] = int(match[5] or 0)
        each, skew = each + count, max(skew, int(match[4] or 0))
        gain = float(match[6] or 0.0)
        if not math.isfinite(gain):
            raise UnreadableFileError(f"{header}: the gain of a signal is {match[6]}; copy it again")
        if gain == 0.0:
            uncalibrated.append(number)
    available = [
        None if frame is None else max(int((path.stat().st_size - offsets[path]) / frame), 0)
        for path, frame in frames.items()
    ]
    counts = [count for count in available if count is not None]
    length = min(counts, default=0) if stated is None else stated
    limits.require_count(length * each, limits.SAMPLES, "samples")
    if skew and skew >= length:
        raise UnreadableFileError(
            f"{header}: a signal of {length} samples begins {skew} samples late; copy it again"
        )
    if uncalibrated:
        log.warning(
            "%s states no gain for signal %s: the WFDB default of 200 units per mV is assumed; its times are "
            "right, its amplitude is not calibrated",
            header,
            ", ".join(map(str, uncalibrated)),
        )
    return tuple(frames), min(counts) if len(counts) == len(available) else None
