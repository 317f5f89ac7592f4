"""Read the numbers in a PLUS sequence's own per-frame fields, sent by a device as lines of text."""

import re
from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, UnreadableFileError

from .raw_sequence import RawSequence

COMPANIONS = ("Timestamp", "Status", "Rate", "Leads", "Unit")
"""Endings of fields that describe another field."""
READABLE_SHARE = 0.9
"""Smallest share of readable lines; a few lines may be garbled in transmission."""

_OF_PLUS = {"Timestamp", "UnfilteredTimestamp", "FrameNumber", "Status", "ImageStatus"}
_SEPARATOR = re.compile(r"[\s,;]+")
_MAYBE_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")


def numeric_fields(raw: RawSequence) -> tuple[str, ...]:
    """List the per-frame fields with numbers that are neither PLUS's own nor describe another field."""
    names = [name for name in raw.frame_fields if name not in _OF_PLUS and not name.endswith("Transform")]
    companions = {f"{name}{ending}" for name in raw.frame_fields for ending in COMPANIONS}
    return tuple(sorted(name for name in names if name not in companions and _holds_numbers(raw, name)))


def numbers_of(path: Path, raw: RawSequence, name: str) -> dict[int, FloatArray]:
    """Read the values in each frame of a field, without empty frames and garbled lines.

    Values are separated by blanks, commas or semicolons; with semicolons a comma is the decimal mark. Values
    of a frame whose `<name>Status` is not OK are NaN.

    Raises:
        UnreadableFileError: ambiguous commas, or too many lines that are not numbers.
    """
    texts = raw.frame_fields[name]
    decimal_comma = _has_decimal_commas(path, name, texts)
    statuses = raw.frame_fields.get(f"{name}Status", {})
    read: dict[int, FloatArray] = {}
    garbled = []
    for frame, text in texts.items():
        values = _values(text.replace(",", ".") if decimal_comma else text)
        if values is None or frame >= raw.frames:
            garbled.append(frame)
        elif len(values):
            ok = statuses.get(frame, "OK").upper() == "OK"
            read[frame] = values if ok else np.full(len(values), np.nan)
    if len(garbled) > (1 - READABLE_SHARE) * len(texts):
        raise UnreadableFileError(
            f"{path}: {name} of frame {garbled[0]} is '{texts[garbled[0]][:40]}'; needed numbers, "
            "separated by blanks, commas or semicolons"
        )
    return read


def _holds_numbers(raw: RawSequence, name: str) -> bool:
    texts = list(raw.frame_fields[name].values())
    readable = [_values(text.replace(";", " ")) for text in texts]
    count = sum(values is not None for values in readable)
    return count >= READABLE_SHARE * len(texts) and any(v is not None and len(v) for v in readable)


def _values(text: str) -> FloatArray | None:
    """Parse the numbers in a line, none if it is blank; None if it holds anything else."""
    try:
        return np.array([float(part) for part in _SEPARATOR.split(text.strip(" ,;\t")) if part])
    except ValueError:
        return None


def _has_decimal_commas(path: Path, name: str, texts: dict[int, str]) -> bool:
    lines = [text for text in texts.values() if "," in text]
    if not lines:
        return False
    if any(";" in line for line in lines):
        return True
    words = [word for line in lines for word in line.split()]
    if all(_MAYBE_DECIMAL_COMMA.fullmatch(word) for word in words):
        raise UnreadableFileError(
            f"{path}: '{lines[0][:40]}' in {name} may be numbers with decimal commas or twice as many "
            "without; write decimal points, or blanks between numbers"
        )
    return False
