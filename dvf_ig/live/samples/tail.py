"""ECG from a file that another program is writing: CSV, a line a sample, or EDF, a record at a time.

Times in the file are not used: a sample was taken just before it appeared (`batches`). Leads are chosen as in
a recording. The file may appear later; when it becomes shorter it is another one. What a file holds when it
is opened is skipped, and so are the first rows of a table.
"""

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from dvf_ig.core import FloatArray, InvalidInputError, UnreadableFileError
from dvf_ig.io.ecg.edf import EdfRecords
from dvf_ig.io.ecg.text_table import LeadColumns
from dvf_ig.io.reading import decode_text
from dvf_ig.io.table_text import first_rows
from dvf_ig.session import EcgSamples

from .batches import BatchClock, plausible

PIECE_BYTES = 1 << 20
LONGEST_LINE = 1 << 16
HEAD_ROWS = 10
"""Rows of a table by which its columns of times and leads are found."""
MOST_HEADER_BYTES = 256 * 513
"""Size of the largest EDF header, of 512 signals."""
EDF_ENDINGS = (".edf", ".bdf")

Split = Callable[[bytes], tuple[FloatArray | None, bytes]]
"""Converts new bytes to (n, leads) samples, None if they hold none, and returns the bytes not used yet."""


class EcgTail:
    """Reader of what is appended to an ECG file; it reports why a file cannot be read.

    Args:
        path: path of the file, which need not exist yet.
        rate_hz: samples a second.
        lead: names of the leads, separated by commas; None takes those that are named as an ECG.
        tell: called with messages about unusable content.
        clock: this machine's monotonic clock.
    """

    def __init__(
        self,
        path: Path,
        rate_hz: float,
        lead: str | None,
        tell: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._path, self._rate_hz, self._lead, self._tell, self._clock = path, rate_hz, lead, tell, clock
        self._split: Split | None = None
        self._times, self._at, self._rest = BatchClock(rate_hz), 0, b""

    def read(self) -> list[EcgSamples]:
        """Return samples that were completed since the last call, the last of which was taken just now."""
        try:
            with self._path.open("rb") as file:
                samples = self._new(file)
        except OSError:
            return []
        except InvalidInputError as error:
            self._tell(str(error))
            return []
        if samples is None:
            return []
        return [EcgSamples(self._times.first_s(len(samples), self._clock()), plausible(samples))]

    def _new(self, file: BinaryIO) -> FloatArray | None:
        size = file.seek(0, 2)
        if self._split is None or size < self._at:
            self._split, self._rest, self._times = None, b"", BatchClock(self._rate_hz)
            if self._path.suffix.lower() in EDF_ENDINGS:
                self._split, self._at = self._open_edf(file, size)
            else:
                self._split, self._at = self._open_table(file, size)
        if self._split is None:
            return None
        file.seek(self._at)
        data = file.read(PIECE_BYTES)
        self._at += len(data)
        samples, self._rest = self._split(self._rest + data)
        return samples

    def _open_edf(self, file: BinaryIO, size: int) -> tuple[Split, int]:
        """Read the header; return the converter of records and the first byte after the whole ones.

        Raises:
            UnreadableFileError: not an EDF, no ECG, or another rate than was stated.
        """
        file.seek(0)
        records = EdfRecords.of(self._path, file.read(MOST_HEADER_BYTES), self._lead)
        if not math.isclose(records.rate_hz, self._rate_hz, rel_tol=1e-3):
            raise UnreadableFileError(
                f"{self._path} has {records.rate_hz:g} samples a second, but live.ecg.rate_hz is "
                f"{self._rate_hz:g} Hz; correct it"
            )
        whole = max(size - records.begin, 0) // records.size_bytes * records.size_bytes

        def split(data: bytes) -> tuple[FloatArray | None, bytes]:
            used = len(data) // records.size_bytes * records.size_bytes
            return records.samples(data[:used]) if used else None, data[used:]

        return split, records.begin + whole

    def _open_table(self, file: BinaryIO, size: int) -> tuple[Split | None, int]:
        """Read the first rows; return the converter of lines and where to begin; None if rows are too few.

        Raises:
            UnreadableFileError: not text, no table, or no ECG.
        """
        file.seek(0)
        head = file.read(LONGEST_LINE)
        if head.startswith((b"\xff\xfe", b"\xfe\xff")):
            raise UnreadableFileError(
                f"{self._path} is UTF-16 text, which is not read while it grows; let its program write UTF-8"
            )
        try:
            text, _ = decode_text(head[: head.rfind(b"\n") + 1])
        except UnicodeDecodeError as exc:
            raise UnreadableFileError(f"{self._path} is no text table; name an EDF .edf") from exc
        rows = first_rows(text, HEAD_ROWS)
        if rows is None:
            return None, 0
        columns = LeadColumns.of(self._path, rows, self._lead)
        file.seek(max(size - LONGEST_LINE, 0))
        last = file.read(min(size, LONGEST_LINE))

        def split(data: bytes) -> tuple[FloatArray | None, bytes]:
            *lines, rest = data.split(b"\n")
            if len(rest) > LONGEST_LINE:
                self._tell(f"{self._path} has a line of more than {LONGEST_LINE} characters; it is skipped")
                rest = b""
            texts = [line.decode("utf-8", "replace") for line in lines if line.strip()]
            return columns.samples(texts) if texts else None, rest

        return split, size - (len(last) - (last.rfind(b"\n") + 1))
