"""Expert annotations of an ECG: each beat with its kind, and the rhythm over time."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, UnreadableFileError, read_only_arrays
from dvf_ig.io.reading import read_bytes

from .recording import split_spec
from .wfdb import existing_record
from .wfdb_header import read_rate_and_length

BEAT_SYMBOLS = frozenset("NLRBAaJSVrFejnE/fQ?")
"""Annotation codes that mark a heart beat (PhysioNet, "WFDB annotation codes")."""
_CODES = {**dict(enumerate("NLRaVFJASEj/Q", start=1)), 25: "B", 30: "?", 34: "e", 35: "n", 38: "f", 41: "r"}
"""Beat symbols by annotation code. Source: WFDB, ecgcodes.h."""
_SKIP, _TEXT = 59, 63


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BeatAnnotations:
    """An expert's beats and rhythms of one recording.

    Attributes:
        t_s: (k,) increasing, s from the start of the record.
        symbols: (k,) PhysioNet's code of each beat, for example "N" or "V".
        rhythms: (start s, name) in order, for example (0.0, "N"), (662.5, "AFIB"); each holds until the next.
    """

    t_s: FloatArray
    symbols: tuple[str, ...]
    rhythms: tuple[tuple[float, str], ...]

    def within(self, rhythm: str, t_s: FloatArray) -> BoolArray:
        """Return (n,) True if `rhythm` holds at times `t_s`."""
        starts = np.array([start for start, _ in self.rhythms])
        names = np.array(["", *(name for _, name in self.rhythms)])
        return np.asarray(names[np.searchsorted(starts, t_s, side="right")] == rhythm)


def read_annotations(spec: str) -> BeatAnnotations:
    """Read beats and rhythms of a WFDB record.

    Args:
        spec: `wfdb:PATH` or one of the record's files; PATH.atr and PATH.hea must exist.
    Raises:
        UnreadableFileError: no annotations, not readable, or truncated: missing annotations would count as
            false detections.
    """
    kind, path = split_spec(spec)
    if kind != "wfdb":
        raise UnreadableFileError(f"'{spec}' has no beat annotations; give a WFDB record as wfdb:RECORD")
    record = existing_record(path)
    file = record.with_name(f"{record.name}.atr")
    data = read_bytes(file, "beat annotations")
    rate_hz, length = read_rate_and_length(record)
    notes = _notes(file, data)
    times = [sample / rate_hz for sample, _, _ in notes]
    if not notes or (length is not None and notes[-1][0] > length):
        raise UnreadableFileError(f"{file}: not readable annotations of this record; copy it again")
    beats = {t: _CODES[code] for t, (_, code, _) in zip(times, notes, strict=True) if code in _CODES}
    beats = {t: symbol for t, symbol in beats.items() if symbol in BEAT_SYMBOLS}
    rhythms = [
        (t, text.strip("\x00")[1:])
        for t, (_, _, text) in zip(times, notes, strict=True)
        if text.startswith("(")
    ]
    order = sorted(beats)
    return BeatAnnotations(np.array(order), tuple(beats[t] for t in order), tuple(rhythms))


def _notes(path: Path, data: bytes) -> list[tuple[int, int, str]]:
    """Decode (sample, code, text) of each annotation; raise if the end mark is missing.

    Source: WFDB annot(5), MIT format: words of 6 bits code and 10 bits time since the previous annotation.
    """
    notes: list[tuple[int, int, str]] = []
    words = np.frombuffer(data[: len(data) // 2 * 2], "<u2")
    at, sample = 0, 0
    while at < len(words):
        code, value = int(words[at]) >> 10, int(words[at]) & 0x3FF
        at += 1
        if code == 0:
            return notes
        if code == _SKIP and at + 1 < len(words):
            step = (int(words[at]) << 16) | int(words[at + 1])
            sample += step - (1 << 32 if step >= 1 << 31 else 0)
            at += 2
        elif code == _TEXT:
            text = data[2 * at : 2 * at + value].decode("latin-1")
            at += (value + 1) // 2
            if notes and at <= len(words):
                notes[-1] = (*notes[-1][:2], text)
            if text.startswith("## time resolution"):
                raise UnreadableFileError(
                    f"{path} states its own time resolution; convert it to that of the record"
                )
        elif code < _SKIP:
            sample += value
            notes.append((sample, code, ""))
        if sample < 0 or (notes and notes[-1][0] > sample):
            raise UnreadableFileError(f"{path}: its annotations run backwards; copy it again")
    at_s = f"; the last whole annotation is at sample {notes[-1][0]}" if notes else ""
    raise UnreadableFileError(f"{path} is truncated: it has no end mark{at_s}; copy it again")
