"""Read EDF recordings: a header of fixed fields, then records of about 1 s with samples of every lead.

Source: Kemp & Olivan 2003, "European data format 'plus' (EDF+)".
"""

import logging
import re
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import AnyArray, FloatArray
from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.core.recordings.signal import Signal
from dvf_ig.io import limits
from dvf_ig.io.reading import read_bytes

from .units import in_millivolts

log = logging.getLogger(__name__)

MOST_DECIMALS = 8
"""Largest number of decimals of a lead's step that counts as a round number."""
MOST_LEADS = 512
_FIXED = {"records": (236, 8), "duration": (244, 8), "leads": (252, 4)}
_WIDTHS = (16, 80, 8, 8, 8, 8, 8, 80, 8, 32)
"""Width of each field of a lead; a field is stored for all leads before the next field."""
_ANNOTATIONS = "EDF Annotations"


@dataclass(frozen=True, slots=True)
class _Lead:
    """A lead's label, unit, physical and digital range, samples per record, and their offset in it."""

    label: str
    unit: str
    physical: tuple[float, float]
    digital: tuple[int, int]
    samples: int
    begin: int


def read_edf(path: Path) -> Signal:
    """Read the ECG leads of an EDF file in mV: those labelled ECG, or all if none is.

    From a truncated file the complete records are read, and a warning says how much is missing.

    Raises:
        UnreadableFileError: absent, damaged, interrupted (EDF+D), or leads of different rates.
    """
    data = read_bytes(path, "an EDF file")
    if len(data) < 256 or data[:8].strip() != b"0":
        raise UnreadableFileError(f"{path} is not a readable EDF file; export it again")
    if data[192:236].decode("latin-1").startswith("EDF+D"):
        raise UnreadableFileError(f"{path} has interruptions (EDF+D); export it as a continuous EDF+C")
    duration_s, leads = _number(path, data, "duration"), _leads(path, data)
    size = sum(lead.samples for lead in leads)
    records = _records(path, data, size, duration_s, len(leads))
    begin = 256 * (len(leads) + 1)
    table = np.frombuffer(data, "<i2", records * size, begin).reshape(records, size)
    signals = [lead for lead in leads if lead.label != _ANNOTATIONS]
    chosen = [lead for lead in signals if "ecg" in lead.label.lower()] or signals
    if not chosen or len({lead.samples for lead in chosen}) != 1:
        listed = ", ".join(f"{s.label} {s.samples / duration_s:g} Hz" for s in chosen) or "none"
        raise UnreadableFileError(f"{path}: leads do not share one rate ({listed}); export the ECG alone")
    columns = [_physical(path, lead, table[:, lead.begin : lead.begin + lead.samples]) for lead in chosen]
    samples = in_millivolts(path, np.column_stack(columns), [lead.unit for lead in chosen])
    labels = tuple(lead.label for lead in chosen)
    return Signal(samples, chosen[0].samples / duration_s, 0.0, labels)


def _records(path: Path, data: bytes, samples: int, duration_s: float, leads: int) -> int:
    """Count the complete records; warn of missing ones."""
    size, stated = 2 * samples, int(_number(path, data, "records"))
    available = len(data) - 256 * (leads + 1)
    whole = available // size
    limits.require_count(whole * samples, limits.SAMPLES, "samples")
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


def _leads(path: Path, data: bytes) -> list[_Lead]:
    count = int(_number(path, data, "leads"))
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
        leads.append(_Lead(label, unit, physical, digital, int(samples), begin))
        begin += int(samples)
    return leads


def _text(cell: bytes) -> str:
    """Decode a header field; replace characters that cannot be printed by blanks."""
    return "".join(c if c.isprintable() else " " for c in cell.decode("latin-1")).strip()


def _real(path: Path, what: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) <= limits.ECG_VALUE:
        raise UnreadableFileError(f"{path}: {what} has the value '{text}' in the header; export it again")
    return value


def _physical(path: Path, lead: _Lead, counts: AnyArray) -> FloatArray:
    """Convert counts to (n,) values in the lead's unit, as multiples of the step that the ranges give.

    A step with few decimals, such as 0.0025 mV, is used as that decimal, not as the quotient of the ranges,
    and its multiples are rounded to decimals: samples digitised in such steps come back bit for bit.
    """
    (low, high), (digital_low, digital_high) = lead.physical, lead.digital
    if low == high or digital_low >= digital_high:
        raise UnreadableFileError(
            f"{path}: {lead.label} has the same smallest and largest value in the header; export it again"
        )
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
