"""ECG from a file that another program is writing: CSV, a line a sample, or EDF, a record at a time.

Times in the file are not used: a sample was taken just before it appeared (`batches`). The file may appear
later, and is read from its start again when it becomes shorter; its first content is skipped.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.session import EcgSamples

from .batches import BatchClock, plausible

PIECE_BYTES = 1 << 20
LONGEST_LINE = 1 << 16
_TIMES = ("t", "t_s", "time", "time_s", "timestamp", "seconds")
"""Headings of columns that are not leads."""
_EDF_HEADER, _EDF_SIGNAL = 256, 256


@dataclass(slots=True)
class _GrowingFile:
    """File that another program is still writing, with the clock of its samples.

    Args:
        path: path of the file, which need not exist yet.
        rate_hz: samples a second.
        tell: called with messages about unusable content.
        clock: this machine's monotonic clock.
    """

    path: Path
    rate_hz: float
    tell: Callable[[str], None]
    clock: Callable[[], float] = time.monotonic
    _times: BatchClock = field(init=False)

    def __post_init__(self) -> None:
        self._times = BatchClock(self.rate_hz)

    def _just_read(self, values: FloatArray) -> list[EcgSamples]:
        """Stamp (n, leads) samples, the last of which was taken just before now."""
        return [EcgSamples(self._times.first_s(len(values), self.clock()), plausible(values))]


@dataclass(slots=True)
class CsvTail(_GrowingFile):
    """Reader of new lines of a growing CSV; every numeric column is a lead, except one named time."""

    _at: int | None = field(default=None, init=False)
    _rest: bytes = field(default=b"", init=False)
    _columns: list[int] | None = field(default=None, init=False)

    def read(self) -> list[EcgSamples]:
        """Return samples of the lines completed since the last call."""
        try:
            data = self._new_bytes()
        except OSError:
            return []
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST_LINE:
            self.tell(f"{self.path} has a line of more than {LONGEST_LINE} characters; it is skipped")
            self._rest = b""
        values = self._values(lines)
        return [] if values is None else self._just_read(values)

    def _new_bytes(self) -> bytes:
        size = self.path.stat().st_size
        with self.path.open("rb") as file:
            if self._at is None:
                self._columns = _columns(file.readline(LONGEST_LINE))
                self._at = size
            elif size < self._at:
                self._at, self._rest = 0, b""
            file.seek(self._at)
            data = file.read(PIECE_BYTES)
        self._at += len(data)
        return data

    def _values(self, lines: list[bytes]) -> FloatArray | None:
        """Parse (n, leads) values; NaN for an invalid line, as a gap keeps its time."""
        rows = [_numbers(line, self._columns) for line in lines if line.strip()]
        leads = max((len(row) for row in rows), default=0)
        if not leads:
            return None
        values = np.full((len(rows), leads), np.nan)
        for i, row in enumerate(rows):
            if len(row) == leads:
                values[i] = row
        return values


@dataclass(slots=True)
class EdfTail(_GrowingFile):
    """Reader of new records of a growing EDF with one rate; it reports why another file cannot be read."""

    _layout: "_EdfLayout | None" = field(default=None, init=False)
    _at: int = field(default=0, init=False)

    def read(self) -> list[EcgSamples]:
        """Return samples of the records completed since the last call."""
        try:
            size = self.path.stat().st_size
            with self.path.open("rb") as file:
                if self._layout is None:
                    self._layout = _edf_layout(file.read(_EDF_HEADER + 64 * _EDF_SIGNAL), self.rate_hz)
                    self._at = self._layout.begin + (size - self._layout.begin) // self._layout.bytes * (
                        self._layout.bytes
                    )
                file.seek(self._at)
                data = file.read(PIECE_BYTES)
        except OSError:
            return []
        except InvalidInputError as error:
            self.tell(f"{self.path}: {error}")
            return []
        whole = len(data) - len(data) % self._layout.bytes
        self._at += whole
        if not whole:
            return []
        return self._just_read(self._layout.values(data[:whole]))


class _EdfLayout:
    """Positions of samples in a record, and their scale."""

    def __init__(self, begin: int, leads: int, samples: int, gain: FloatArray, offset: FloatArray) -> None:
        self.begin, self.bytes = begin, 2 * leads * samples
        self._leads, self._samples, self._gain, self._offset = leads, samples, gain, offset

    def values(self, data: bytes) -> FloatArray:
        """Convert a record to (n, leads) in the file's unit."""
        raw = np.frombuffer(data, dtype="<i2").reshape(-1, self._leads, self._samples)
        return np.asarray(raw.transpose(0, 2, 1).reshape(-1, self._leads) * self._gain + self._offset)


def _edf_layout(head: bytes, rate_hz: float) -> _EdfLayout:
    """Read the layout from the header of an EDF.

    Raises:
        InvalidInputError: not an EDF, signals of several rates, or another rate than was stated.
    """
    try:
        begin, seconds = int(head[184:192]), float(head[244:252])
        leads = int(head[252:256])

        def numbers(first: int, size: int) -> FloatArray:
            at = _EDF_HEADER + first * leads
            return np.array([float(head[at + i * size : at + (i + 1) * size]) for i in range(leads)])

        low, high = numbers(104, 8), numbers(112, 8)
        least, most = numbers(120, 8), numbers(128, 8)
        samples = numbers(216, 8)
    except ValueError as exc:
        raise InvalidInputError(f"it is not an EDF ({exc}); the file may be a CSV: name it .csv") from exc
    ok = 1 <= leads <= 64 and seconds > 0 and len(set(samples.tolist())) == 1 and (most > least).all()
    if not ok or not math.isclose(samples[0] / seconds, rate_hz, rel_tol=1e-3):
        raise InvalidInputError(
            f"its {leads} signals have {samples.tolist()[:4]} samples in {seconds:g} s; needed one rate, "
            f"{rate_hz:g} Hz"
        )
    gain = (high - low) / (most - least)
    return _EdfLayout(begin, leads, int(samples[0]), gain, low - gain * least)


def _columns(first_line: bytes) -> list[int] | None:
    """Find the columns that are leads by a table's heading; None without a heading: all of them."""
    cells = first_line.decode("utf-8", "replace").replace(";", ",").strip().split(",")
    if all(_is_number(cell) for cell in cells):
        return None
    return [i for i, cell in enumerate(cells) if cell.strip().lower() not in _TIMES]


def _numbers(line: bytes, columns: list[int] | None) -> list[float]:
    cells = line.decode("utf-8", "replace").replace(";", ",").split(",")
    chosen = cells if columns is None else [cells[i] for i in columns if i < len(cells)]
    return [float(cell) if _is_number(cell) else math.nan for cell in chosen]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
