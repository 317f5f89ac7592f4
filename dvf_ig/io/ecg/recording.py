"""Read and write ECG recordings, named by `wfdb:PATH`, `edf:PATH` or `csv:PATH`."""

import re
from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.core.signal import Signal
from dvf_ig.io.atomic import write_text
from dvf_ig.io.reading import read_text, reading

from .wfdb_edf import read_edf, read_wfdb

_UNIT_SUFFIX = re.compile(r"(.*?)\s*\[(.+)\]")
_EMPTY_CELL = re.compile(r"(?<=,)[ \t]*(?=,|$)", re.MULTILINE)


def read_ecg(spec: str) -> Signal:
    """Read a recording.

    Args:
        spec: `wfdb:PATH` (record without suffix), `edf:PATH`, or `csv:PATH` with a header
            `t_s,<lead>[,<lead>…]`, times in s and evenly spaced, leads in mV (or `<lead> [unit]`).
    Returns:
        all leads; NaN where the recorder delivered no sample; WFDB and EDF start at 0 s.
    Raises:
        InvalidInputError: `spec` names no known format.
        UnreadableFileError: absent, damaged, or unevenly sampled.
        MissingDependencyError: WFDB or EDF without `pip install "dvf-ig[ecg]"`.
    """
    kind, path = split_spec(spec)
    with reading(path, f"an ECG ({kind})"):
        if kind == "wfdb":
            return read_wfdb(path)
        return read_edf(path) if kind == "edf" else _read_csv(path)


def split_spec(spec: str) -> tuple[str, Path]:
    """`wfdb:PATH` → ("wfdb", PATH).

    Raises:
        InvalidInputError: no or an unknown prefix, or no path.
    """
    kind, colon, path = str(spec).partition(":")
    if not colon or kind not in ("wfdb", "edf", "csv") or not path:
        raise InvalidInputError(
            f"'{spec}' names no ECG; write wfdb:RECORD (without suffix), edf:FILE or csv:FILE"
        )
    return kind, Path(path)


def write_ecg_csv(signal: Signal, path: Path | str) -> None:
    """Write a recording as CSV: header `t_s,<lead>…`, every digit kept, `nan` for missing samples.

    Raises:
        InvalidInputError: a lead name with a comma, bracket or line break.
        OutputError: not writable.
    """
    for lead in signal.leads:
        if re.search(r"[,\[\]\r\n\"]", lead):
            raise InvalidInputError(f"lead name '{lead}' cannot stand in a CSV header; rename the lead")
    note = "" if signal.unit == "mV" else f" [{signal.unit}]"
    table = np.column_stack([signal.t_s, signal.samples]).tolist()
    lines = [",".join(["t_s", *(lead + note for lead in signal.leads)])]
    lines += [",".join(map(repr, row)) for row in table]
    write_text(Path(path), "\n".join(lines) + "\n")


def _read_csv(path: Path) -> Signal:
    header, _, body = read_text(path, "an ECG table").partition("\n")
    names = [name.strip().strip('"') for name in header.split(",")]
    if len(names) < 2 or names[0] != "t_s":
        raise UnreadableFileError(
            f"{path}: the first line is '{header.strip()[:60]}'; needed a header t_s,<lead>[,<lead>]"
        )
    try:
        rows = [line for line in _EMPTY_CELL.sub("nan", body).splitlines() if line.strip()]
        table = np.loadtxt(rows, delimiter=",", ndmin=2) if rows else np.zeros((0, len(names)))
    except ValueError as exc:
        raise UnreadableFileError(f"{path}: {str(exc).split(';')[0]}; needed numbers only") from exc
    if table.shape[1] != len(names):
        raise UnreadableFileError(f"{path}: {table.shape[1]} columns under {len(names)} names")
    if len(table) < 2:
        raise UnreadableFileError(f"{path} has {len(table)} samples; needed at least 2")
    leads, unit = _leads_and_unit(path, names[1:])
    return Signal(table[:, 1:], even_rate_hz(path, table[:, 0]), float(table[0, 0]), leads, unit)


def _leads_and_unit(path: Path, names: list[str]) -> tuple[tuple[str, ...], str]:
    matches = [_UNIT_SUFFIX.fullmatch(name) for name in names]
    units = {match[2] if match else "mV" for match in matches}
    if len(units) > 1:
        raise UnreadableFileError(f"{path}: leads in different units ({', '.join(sorted(units))}); use one")
    return tuple(m[1] if m else name for m, name in zip(matches, names, strict=True)), units.pop()


def even_rate_hz(path: Path, t_s: FloatArray) -> float:
    """Sampling rate of evenly spaced times, the roundest one that gives exactly these times.

    Raises:
        UnreadableFileError: a time is not finite, repeats, or is more than half a sample out of step.
    """
    steps = np.diff(t_s)
    step = float(np.median(steps))
    uneven = ~(np.abs(steps - step) <= 0.5 * step)
    drift = np.abs(t_s - np.linspace(t_s[0], t_s[-1], len(t_s)))
    if uneven.any() or not (drift <= 2 * step).all():
        row = int(np.flatnonzero(uneven)[0]) if uneven.any() else int(drift.argmax())
        raise UnreadableFileError(
            f"{path}: samples are not evenly spaced (row {row + 1}, at {t_s[row]:g} s, is out of step with "
            f"{step:g} s elsewhere); resample to a fixed rate, missing samples as nan"
        )
    estimate = float((len(t_s) - 1) / (t_s[-1] - t_s[0]))
    index = np.arange(len(t_s))
    for candidate in (*(round(estimate, digits) for digits in range(10)), *_neighbours(estimate)):
        if candidate > 0 and np.array_equal(t_s[0] + index / candidate, t_s):
            return candidate
    return estimate


def _neighbours(value: float, count: int = 8) -> list[float]:
    """The floats closest to `value`, nearest first."""
    up, down, out = value, value, [value]
    for _ in range(count):
        up, down = float(np.nextafter(up, np.inf)), float(np.nextafter(down, 0.0))
        out += [up, down]
    return out
