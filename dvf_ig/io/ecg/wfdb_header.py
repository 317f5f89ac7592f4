"""The header of a WFDB record, checked before the package wfdb reads the samples.

Source: WFDB header(5): a record line "name[/segments] signals rate samples …", then a line for each signal
"file format gain …", or for each segment "name samples".
"""

import re
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.io import limits
from dvf_ig.io.file_within import file_within
from dvf_ig.io.reading import read_text

MOST_LEADS = 512
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
_SIGNAL = re.compile(r"(\S+)\s+(\d{1,3})(?:x(\d{1,4}))?(?::\d{1,9})?(?:\+(\d{1,9}))?(?:\s.*)?")


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
        return RecordHeader((header, *_of_segments(header, lines, record.name)), rate_hz, stated, None)
    files, held = _of_signals(header, lines)
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


def _of_segments(header: Path, lines: list[str], name: str) -> list[Path]:
    """The files of every segment, which has a header of its own."""
    files: list[Path] = []
    for segment in dict.fromkeys(line.split()[0] for line in lines):
        if segment == "~":
            continue
        own = file_within(header.parent, f"{segment}.hea", header)
        begin = own.read_bytes()[:4096].decode("latin-1").lstrip().split("\n")[0]
        if segment == name or "/" in begin.split(" ")[0]:
            raise UnreadableFileError(f"{header}: its segment '{segment}' has segments itself; copy it again")
        if re.search(r"\n\s*~\s", "\n" + own.read_bytes().decode("latin-1")):
            files.append(own)  # the layout of a record whose leads vary: no samples
            continue
        files += read_record_header(own.with_suffix("")).files
    return files


def _of_signals(header: Path, lines: list[str]) -> tuple[list[Path], int | None]:
    """The signal files in order, and whole samples of each lead that all of them hold."""
    frames: dict[Path, Fraction | None] = {}
    offsets: dict[Path, int] = {}
    for line in lines:
        found = _SIGNAL.fullmatch(line)
        if found is None or found[2] not in _BYTES:
            raise UnreadableFileError(f"{header}: the line of a signal is '{line[:60]}'; copy it again")
        path, size = file_within(header.parent, found[1], header), _BYTES[found[2]]
        before = frames.get(path, Fraction(0))
        frames[path] = None if size is None or before is None else before + size * int(found[3] or 1)
        offsets[path] = int(found[4] or 0)
    held = [
        None if frame is None else int((path.stat().st_size - offsets[path]) / frame)
        for path, frame in frames.items()
    ]
    known = [count for count in held if count is not None]
    limits.require_count(min(known, default=0) * len(lines), limits.SAMPLES, "samples")
    return list(frames), min(known) if len(known) == len(held) else None
