"""What an expert wrote beside an ECG: each beat with its kind, and the rhythm from moment to moment."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core import read_only_arrays
from dvf_ig.core.arrays import BoolArray, FloatArray
from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.io.reading import read_bytes

from .recording import split_spec
from .wfdb_edf import DAMAGE, existing_record, quiet, wfdb_package

BEAT_SYMBOLS = frozenset("NLRBAaJSVrFejnE/fQ?")
"""Annotation codes that mark a heart beat (PhysioNet, "WFDB annotation codes")."""


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
        """(n,) True where `rhythm` holds at times `t_s`."""
        starts = np.array([start for start, _ in self.rhythms])
        names = np.array(["", *(name for _, name in self.rhythms)])
        return np.asarray(names[np.searchsorted(starts, t_s, side="right")] == rhythm)


def read_annotations(spec: str) -> BeatAnnotations:
    """Beats and rhythms of a WFDB record.

    Args:
        spec: `wfdb:PATH` or one of the record's files; PATH.atr and PATH.hea must exist.
    Raises:
        MissingDependencyError: the package wfdb is absent.
        UnreadableFileError: no annotations, or not readable.
    """
    kind, path = split_spec(spec)
    if kind != "wfdb":
        raise UnreadableFileError(f"'{spec}' has no beat annotations; give a WFDB record as wfdb:RECORD")
    wfdb = wfdb_package()
    record = existing_record(path)
    for ending in (".atr", ".hea"):
        read_bytes(Path(f"{record}{ending}"), "beat annotations")
    try:
        with quiet():
            rate_hz = float(wfdb.rdheader(str(record.resolve())).fs)
            notes = wfdb.rdann(str(record.resolve()), "atr")
    except DAMAGE as exc:
        raise UnreadableFileError(f"{record}.atr: not readable annotations ({exc}); copy it again") from exc
    beats = {s: y for s, y in zip(notes.sample, notes.symbol, strict=True) if y in BEAT_SYMBOLS}
    rhythms = [
        (float(s) / rate_hz, text.strip("\x00")[1:])
        for s, text in zip(notes.sample, notes.aux_note, strict=True)
        if text.startswith("(")
    ]
    order = sorted(beats)
    t_s = np.array(order, dtype=np.float64) / rate_hz
    return BeatAnnotations(t_s, tuple(beats[s] for s in order), tuple(rhythms))
