"""Read EDF and BDF recordings: a header of fixed fields, then records with samples of every signal.

Sources: Kemp & Olivan 2003, "European data format 'plus' (EDF+)"; BioSemi, "BDF file format" (24 bits).
"""

import logging
import re
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from dvf_ig.core import AnyArray, FloatArray, Signal, UnreadableFileError
from dvf_ig.io import limits
from dvf_ig.io.reading import read_bytes

from .leads import Channel, choose_leads, in_millivolts

log = logging.getLogger(__name__)

MOST_DECIMALS = 8
"""Largest number of decimals of a lead's step that counts as a round number."""
MOST_LEADS = 512
_FIXED = {"header bytes": (184, 8), "records": (236, 8), "duration": (244, 8), "leads": (252, 4)}
_WIDTHS = (16, 80, 8, 8, 8, 8, 8, 80, 8, 32)
"""Width of each field of a lead; a field is stored for all leads before the next field."""
_ANNOTATIONS = re.compile("[EB]DF Annotations")
_ONSET = re.compile(rb"([+-]\d+(?:\.\d*)?)(?:\x15[\d.]*)?\x14")
"""Time of a record, with which its annotations begin."""


@dataclass(frozen=True, slots=True)
class _Lead:
    """A lead's label, unit, physical and digital range, samples per record, and their offset in it."""

    label: str
    unit: str
    physical: tuple[float, float]
    digital: tuple[int, int]
    samples: int
    begin: int


def read_edf(path: Path, lead: str | None = None) -> Signal:
    """Read the ECG leads of an EDF or BDF file in mV (`choose_leads`).

    From a truncated file the complete records are read, and a warning says how much is missing.

    Args:
        path: the file.
        lead: labels of the leads to take instead, separated by commas.
    Raises:
        UnreadableFileError: absent, damaged, interrupted, a header that contradicts itself or the size of the
            file, no ECG, or leads of different rates.
    """
    data = read_bytes(path, "an EDF file")
    duration_s, leads, bdf = _header(path, data)
    size = sum(lead.samples for lead in leads)
    records = _records(path, data, size * (3 if bdf else 2), duration_s, len(leads))
    limits.require_count(records * size, limits.SAMPLES, "samples")
    begin = 256 * (len(leads) + 1)
    table = _samples(data, begin, records * size, bdf=bdf).reshape(records, size)
    interrupted = data[192:236].decode("latin-1")[1:].startswith("DF+D")
    _require_continuous(path, table, leads, duration_s, interrupted=interrupted)
    signals, channels = _channels(leads, duration_s)
    chosen = choose_leads(path, channels, lead)
    columns = [
        _physical(path, one, table[:, one.begin : one.begin + one.samples])
        for one in (signals[i] for i in chosen)
    ]
    samples, unit = in_millivolts(path, np.column_stack(columns), [channels[i] for i in chosen])
    rate_hz = signals[chosen[0]].samples / duration_s
    left_out = tuple(channel.label for i, channel in enumerate(channels) if i not in chosen)
    return Signal(samples, rate_hz, 0.0, tuple(signals[i].label for i in chosen), unit, left_out)


@dataclass(frozen=True, slots=True)
class EdfRecords:
    """ECG leads in the records of an EDF or BDF file that grows.

    Attributes:
        begin: first byte of the first record.
        size_bytes: of a record.
        rate_hz: of the leads.
    """

    begin: int
    size_bytes: int
    rate_hz: float
    _leads: tuple[_Lead, ...]
    _bdf: bool

    @classmethod
    def of(cls, path: Path, head: bytes, lead: str | None) -> "EdfRecords":
        """Read a header, and choose the leads as `read_edf` does.

        Raises:
            UnreadableFileError: no EDF, a header that contradicts itself, or no ECG.
        """
        duration_s, leads, bdf = _header(path, head)
        signals, channels = _channels(leads, duration_s)
        chosen = tuple(signals[i] for i in choose_leads(path, channels, lead))
        for one in chosen:
            _require_range(path, one)
        size = sum(one.samples for one in leads) * (3 if bdf else 2)
        return cls(256 * (len(leads) + 1), size, chosen[0].samples / duration_s, chosen, bdf)

    def samples(self, data: bytes) -> FloatArray:
        """Convert whole records to (n, leads) in the file's units."""
        table = _samples(data, 0, len(data) // (3 if self._bdf else 2), bdf=self._bdf)
        table = table.reshape(len(data) // self.size_bytes, -1)
        return np.column_stack(
            [_scaled(one, table[:, one.begin : one.begin + one.samples]) for one in self._leads]
        )


def _header(path: Path, data: bytes) -> tuple[float, list[_Lead], bool]:
    """Read duration of a record in s and its signals, and whether samples have 24 bits."""
    bdf = data[:8] == b"\xffBIOSEMI"
    if len(data) < 256 or not (bdf or data[:8].strip() == b"0"):
        raise UnreadableFileError(f"{path} is not a readable EDF or BDF file; export it again")
    return _number(path, data, "duration"), _leads(path, data, bits=24 if bdf else 16), bdf


def _channels(leads: list[_Lead], duration_s: float) -> tuple[list[_Lead], list[Channel]]:
    """Return the signals that are no annotations."""
    signals = [lead for lead in leads if not _ANNOTATIONS.fullmatch(lead.label)]
    return signals, [Channel(lead.label, lead.unit, lead.samples / duration_s) for lead in signals]


def _samples(data: bytes, begin: int, count: int, *, bdf: bool) -> AnyArray:
    """Decode little-endian samples of 16 bits, or of 24 bits in a BDF."""
    if not bdf:
        return np.frombuffer(data, "<i2", count, begin)
    low = np.frombuffer(data, np.uint8, 3 * count, begin).reshape(count, 3)
    wide = np.zeros((count, 4), np.uint8)
    wide[:, 1:] = low
    return np.asarray(wide.view("<i4")[:, 0] >> 8)


def _require_continuous(
    path: Path, table: AnyArray, leads: list[_Lead], duration_s: float, *, interrupted: bool
) -> None:
    """Compare the times of the records, which EDF+ keeps in its annotations, with records without a gap."""
    notes = next((lead for lead in leads if _ANNOTATIONS.fullmatch(lead.label)), None)
    columns = (
        np.zeros((len(table), 0), "<i2") if notes is None else table[:, notes.begin :][:, : notes.samples]
    )
    matches = [] if table.dtype.itemsize > 2 else [_ONSET.match(row.tobytes()) for row in columns]
    onsets = [(k, float(match[1])) for k, match in enumerate(matches) if match is not None]
    off = [k for k, onset_s in onsets if abs(onset_s - onsets[0][1] - (k - onsets[0][0]) * duration_s) > 1e-3]
    if off or (interrupted and len(onsets) < len(table)):
        where = f", first before record {off[0] + 1} of {len(table)}" if off else " (EDF+D)"
        raise UnreadableFileError(
            f"{path} has interruptions{where}; export a part without interruption as EDF+C"
        )


def _records(path: Path, data: bytes, size: int, duration_s: float, leads: int) -> int:
    """Count the complete records of `size` bytes; warn of missing ones."""
    stated = int(_number(path, data, "records"))
    available = len(data) - 256 * (leads + 1)
    whole = available // size
    if whole < 1:
        raise UnreadableFileError(f"{path} is truncated: it holds no whole record; export it again")
    if stated < 0 or whole < stated:
        problem = (
            "does not say how many records it has, as when a recorder is stopped"
            if stated < 0
            else (f"is truncated: it has {whole} of {stated} records")
        )
        missing = "" if stated < 0 else f"; the last {(stated - whole) * duration_s:g} s are missing"
        log.warning("%s %s: %g s are read%s", path, problem, whole * duration_s, missing)
    elif available != stated * size:
        raise UnreadableFileError(
            f"{path} is longer than its header says: {available} bytes of samples, its {stated} records have "
            f"{stated * size}; export it again"
        )
    return whole


def _number(path: Path, data: bytes, name: str) -> float:
    """Read a number of the fixed part of the header."""
    at, width = _FIXED[name]
    text = data[at : at + width].decode("latin-1").strip()
    if name == "duration":
        value = _real(path, "the duration of a record", text)
        if not 1e-3 <= value <= 3600:
            raise UnreadableFileError(f"{path}: its records last {text} s; needed 0.001 to 3600")
        return value
    if re.fullmatch(r"-1|\d+", text) is None or (name == "leads" and not 1 <= int(text) <= MOST_LEADS):
        raise UnreadableFileError(f"{path}: its number of {name} is '{text}'; export it again")
    return float(text)


def _leads(path: Path, data: bytes, bits: int) -> list[_Lead]:
    count, stated = int(_number(path, data, "leads")), int(_number(path, data, "header bytes"))
    if stated != 256 * (count + 1):
        raise UnreadableFileError(
            f"{path}: its header says that it has {stated} bytes, but {count} signals need "
            f"{256 * (count + 1)}; export it again"
        )
    if len(data) < 256 * (count + 1):
        raise UnreadableFileError(f"{path} is truncated within its header ({len(data)} bytes); copy it again")
    at, columns = 256, list[list[str]]()
    for width in _WIDTHS:
        cells = (data[at + i * width : at + (i + 1) * width] for i in range(count))
        columns.append([_text(cell) for cell in cells])
        at += width * count
    leads, begin = [], 0
    for label, _, unit, low, high, digital_low, digital_high, _, samples, _ in zip(*columns, strict=True):
        if re.fullmatch(r"[1-9]\d{0,6}", samples) is None:
            raise UnreadableFileError(f"{path}: {label} has '{samples}' samples a record; export it again")
        physical = (_real(path, label, low), _real(path, label, high))
        digital = (int(_real(path, label, digital_low)), int(_real(path, label, digital_high)))
        if max(-digital[0] - 1, digital[1]) >= 1 << (bits - 1):
            raise UnreadableFileError(
                f"{path}: {label} has digital values from {digital[0]} to {digital[1]} in the header, which "
                f"{bits} bits do not hold; export it again"
            )
        leads.append(_Lead(label, unit, physical, digital, int(samples), begin))
        begin += int(samples)
    return leads


def _text(cell: bytes) -> str:
    """Decode a header field; replace characters that cannot be printed by blanks."""
    try:
        text = cell.decode("utf-8")  # against the standard, for a µ
    except UnicodeDecodeError:
        text = cell.decode("latin-1")
    return "".join(c if c.isprintable() else " " for c in text).strip()


def _real(path: Path, what: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) <= limits.ECG_VALUE:
        raise UnreadableFileError(f"{path}: {what} has the value '{text}' in the header; export it again")
    return value


def _physical(path: Path, lead: _Lead, counts: AnyArray) -> FloatArray:
    """Convert counts to (n,) values in the lead's unit, and warn of those outside the header's range."""
    _require_range(path, lead)
    digital_low, digital_high = lead.digital
    outside = float(((counts < digital_low) | (counts > digital_high)).mean())
    if outside:
        log.warning(
            f"{path}: {100 * outside:.2g} % of the samples of {lead.label} are outside the header's digital "
            "range; its gain may be wrong"
        )
    return _scaled(lead, counts)


def _require_range(path: Path, lead: _Lead) -> None:
    """Refuse a lead whose ranges give no step."""
    if lead.digital[0] > lead.digital[1]:
        raise UnreadableFileError(
            f"{path}: the digital minimum of {lead.label}, {lead.digital[0]:g}, is above its maximum, "
            f"{lead.digital[1]:g}; export it again"
        )
    if lead.physical[0] == lead.physical[1] or lead.digital[0] == lead.digital[1]:
        raise UnreadableFileError(
            f"{path}: {lead.label} has the same smallest and largest value in the header; export it again"
        )


def _scaled(lead: _Lead, counts: AnyArray) -> FloatArray:
    """Convert counts to (n,) values in the lead's unit, as multiples of the step that the ranges give.

    A step with few decimals, such as 0.0025 mV, is used as that decimal, not as the quotient of the ranges,
    and its multiples are rounded to decimals: samples digitised in such steps come back bit for bit.
    """
    (low, high), (digital_low, digital_high) = lead.physical, lead.digital
    step = (high - low) / (digital_high - digital_low)
    steps = counts.reshape(-1).astype(np.float64) - digital_high
    plain = f"{step:.12g}"
    decimals = max(_decimals(plain), _decimals(repr(high)))
    if decimals > MOST_DECIMALS or abs(float(plain) - step) > 1e-13 * abs(step):
        return np.asarray(high + steps * step)
    return np.asarray(np.round(high + steps * float(plain), decimals))


def _decimals(number: str) -> int:
    """Count the digits after the decimal point."""
    return -int(Decimal(number).as_tuple().exponent)
