"""Read an ECG from a text table: one row per sample, any usual separator, optional header and times."""

import logging
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core.arrays import FloatArray, read_only_arrays
from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.core.recordings.signal import Signal
from dvf_ig.io.reading import read_text

from .clock_times import clock_seconds, past_midnight
from .even_rate import even_rate_hz

log = logging.getLogger(__name__)

_UNIT_SUFFIX = re.compile(r"(.*?)\s*[\[(](.+)[\])]|(.*?)[_ ](s|sec|ms|us|ns|mv|uv)", re.IGNORECASE)
_TIME_NAMES = {"t", "time", "times", "timestamp", "timestamps", "elapsed time", "elapsed", "seconds", "sec"}
_COUNT_NAMES = {"sample", "samples", "sample #", "index", "sample index", "sample number"}
_IN_ONE_SECOND = {"s": 1.0, "sec": 1.0, "ms": 1e3, "us": 1e6, "µs": 1e6, "μs": 1e6, "ns": 1e9}
_LONGEST_STEP_S = 0.05
"""Below 20 Hz it is no ECG; with steps of 0.02 ms or more (50 kHz), only one time unit fits a step."""
_SHORTEST_STEP_S = 2e-5
_LATEST = 1e19
"""Largest plausible time: nanoseconds since 1970 reach 1.8e18."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """Column names (None without a header) and (n, columns) values; NaN for empty cells.

    `clock` is the column with times of day or elapsed times, converted to s.
    """

    names: tuple[str, ...] | None
    values: FloatArray
    clock: int | None


def read_ecg_table(path: Path, rate_hz: float | None = None) -> Signal:
    """Read an ECG from a text table, one row per sample.

    Cells are separated by commas, semicolons, tabs or blanks; with semicolons, tabs or one column alone a
    comma may be the decimal mark. A header names the columns, `t_s,II,V1` or `Timestamp;ECG (mV)`; a second
    row may hold their units, as rdsamp of PhysioNet writes them. Times are in a column named t, time or
    timestamp, or in a first column that always increases; their unit is the one in its name (`t_ms`,
    `time [ms]`), else the one of s, ms, µs and ns that gives 20 Hz or more. Times of day and elapsed times
    (13:59:50.004, 0:02.778) become seconds since midnight or since the start. Leads are in mV unless
    their names say otherwise.

    Args:
        path: the file.
        rate_hz: sampling rate of a table without times; sample 0 is then at 0 s.
    Raises:
        UnreadableFileError: absent, no table of numbers, neither times nor a rate, unevenly sampled, or times
            of another rate or unit.
    """
    table = _parse(path, read_text(path, "an ECG table"))
    names = table.names or tuple(f"column {i + 1}" for i in range(table.values.shape[1]))
    at, counts = _time_column(table), _count_column(table)
    empty = [i for i, name in enumerate(names) if not name and np.isnan(table.values[:, i]).all()]
    leads = [i for i in range(len(names)) if i not in (at, counts, *empty)]
    if not leads:
        raise UnreadableFileError(f"{path} has no column of an ECG, only {', '.join(names)[:60]}")
    labels, unit = _leads_and_unit(path, [names[i] for i in leads])
    samples = table.values[:, leads]
    if at is None:
        if rate_hz is None:
            raise UnreadableFileError(
                f"{path} has no column of times (named t_s, time or timestamp) among "
                f"{', '.join(names)[:60]}; give its sampling rate in Hz",
                settings=("ecg.rate_hz",),
            )
        return Signal(samples, rate_hz, 0.0, labels, unit)
    t_s = _seconds(path, table, at)
    measured_hz = even_rate_hz(path, t_s)
    if rate_hz is not None and abs(rate_hz - measured_hz) > 0.01 * measured_hz:
        raise UnreadableFileError(
            f"{path}: its times are at {measured_hz:.4g} Hz, but --rate is {rate_hz:g} Hz; omit it"
        )
    return Signal(samples, rate_hz or measured_hz, float(t_s[0]), labels, unit)


def _parse(path: Path, text: str) -> _Table:
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if lines and not any(mark in line for line in lines[:2] for mark in ";\t,") and " " in lines[-1].strip():
        lines = [",".join(line.split()) for line in lines]
    separator = next((mark for mark in ";\t" if any(mark in line for line in lines[:2])), ",")
    header = _cells(lines[0], separator) if lines else []
    has_header = not all(_is_number(cell, separator) for cell in header)
    rows = lines[1:] if has_header else lines
    if has_header and rows:
        header, rows = _with_units(header, rows, separator)
    if separator == "," and _decimal_commas(header if has_header else None, rows):
        separator = ";"  # one column, whose commas are decimal marks
        header = _cells(lines[0], separator)
    if separator != ",":
        rows = [row.replace(",", ".") for row in rows]
    rows, clock = _without_clock(rows, separator)
    empty = re.compile(rf"(?<={separator})[ ]*(?={separator}|$)|^[ ]*(?={separator})")
    rows = [empty.sub("nan", row).replace('"', "") for row in rows]
    if len(rows) < 2:
        raise UnreadableFileError(f"{path} has {len(rows)} samples; needed at least 2")
    try:
        values = np.loadtxt(rows, delimiter=separator, ndmin=2)
    except ValueError as exc:
        raise UnreadableFileError(f"{path}: {str(exc).split(';')[0]}; needed numbers only") from exc
    if values.shape[1] != len(header):
        raise UnreadableFileError(f"{path}: {values.shape[1]} columns under {len(header)} names")
    return _Table(tuple(header) if has_header else None, values, clock)


def _with_units(header: list[str], rows: list[str], separator: str) -> tuple[list[str], list[str]]:
    """Add the units of a second row to the names, and return the rows after it."""
    units = _cells(rows[0], separator)
    if len(units) != len(header) or any(_is_number(cell, separator) for cell in units):
        return header, rows
    plain = [unit if unit.lower() in (*_IN_ONE_SECOND, "mv", "uv", "µv", "v") else "" for unit in units]
    return [f"{name} [{unit}]" if unit else name for name, unit in zip(header, plain, strict=True)], rows[1:]


def _without_clock(rows: list[str], separator: str) -> tuple[list[str], int | None]:
    """Convert times of day to seconds, and return the rows and the column of these times."""
    first = [clock_seconds(cell) for cell in _cells(rows[0], separator)] if rows else []
    at = next((i for i, seconds in enumerate(first) if seconds is not None), None)
    if at is None:
        return rows, None
    split = [_cells(row, separator) for row in rows]
    for cells in split:
        seconds = clock_seconds(cells[at]) if len(cells) > at else None
        if seconds is not None:
            cells[at] = repr(seconds)
    return [separator.join(cells) for cells in split], at


def _cells(line: str, separator: str) -> list[str]:
    return [cell.strip().strip("\"'").strip() for cell in line.split(separator)]


def _is_number(cell: str, separator: str) -> bool:
    try:
        float(cell.replace(",", ".") if separator != "," else cell or "nan")
    except ValueError:
        return cell == "" or clock_seconds(cell) is not None
    return True


def _decimal_commas(header: list[str] | None, rows: list[str]) -> bool:
    """Return whether each row's one comma is a decimal mark: under one name, or before digits like 05."""
    if any(row.count(",") != 1 or "." in row for row in rows[:1000]):
        return False
    if header is not None:
        return len(header) == 1
    return any(re.search(r",0\d|^\s*-0,", row) for row in rows)


def _time_column(table: _Table) -> int | None:
    """Find the column of times of day or with a time name; else the first of several columns if it always
    increases and is not a sample count.
    """
    if table.clock is not None:
        return table.clock
    for i, name in enumerate(table.names or ()):
        if _name_and_unit(name)[0].lower() in _TIME_NAMES or name.lower() in _IN_ONE_SECOND:
            return i
    first = table.values[:, 0]
    increases = table.values.shape[1] > 1 and bool((np.diff(first) > 0).all())
    return 0 if increases and _count_column(table) is None else None


def _count_column(table: _Table) -> int | None:
    """Find the column of sample numbers: by name, or without a header a first column n, n+1, …"""
    for i, name in enumerate(table.names or ()):
        if name.lower() in _COUNT_NAMES:
            return i
    several = table.names is None and table.values.shape[1] > 1
    return 0 if several and bool((np.diff(table.values[:, 0]) == 1).all()) else None


def _name_and_unit(name: str) -> tuple[str, str | None]:
    """Split a column name: "time [ms]" → ("time", "ms"), "t_s" → ("t", "s"), "II" → ("II", None)."""
    match = _UNIT_SUFFIX.fullmatch(name)
    if match is None:
        return name, None
    return (match[1], match[2]) if match[2] else (match[3], match[4])


def _seconds(path: Path, table: _Table, at: int) -> FloatArray:
    """Convert the times to s with the unit in the column's name, else the one that fits their steps."""
    times, name = table.values[:, at], table.names[at] if table.names else ""
    if (np.abs(times) > _LATEST).any():
        raise UnreadableFileError(
            f"{path}: its times reach {np.nanmax(np.abs(times)):.3g}; needed times in s, ms, µs or ns"
        )
    if at == table.clock:
        return past_midnight(times)
    stated = (_name_and_unit(name)[1] or name).lower()
    step = float(np.median(np.diff(times)))
    if stated in _IN_ONE_SECOND:
        step_s = step / _IN_ONE_SECOND[stated]
        if step_s > _LONGEST_STEP_S or 0 < step_s < _SHORTEST_STEP_S:
            raise UnreadableFileError(
                f"{path}: its times step by {step:g} {stated} (column '{name}'); no ECG is sampled at "
                f"{1 / step_s:.3g} Hz: correct the unit in the header"
            )
        return times / _IN_ONE_SECOND[stated]
    for unit in ("s", "ms", "us", "ns"):
        if step / _IN_ONE_SECOND[unit] <= _LONGEST_STEP_S:
            if unit != "s":
                log.warning("%s: its times step by %g, so they are read as %s", path, step, unit)
            return times / _IN_ONE_SECOND[unit]
    raise UnreadableFileError(f"{path}: times step by {step:g}; name their unit in the header, as in t_ms")


def _leads_and_unit(path: Path, names: list[str]) -> tuple[tuple[str, ...], str]:
    leads = [_name_and_unit(name) for name in names]
    units = {"mV" if unit is None or unit.lower() == "mv" else unit for _, unit in leads}
    if len(units) > 1:
        raise UnreadableFileError(f"{path}: leads in different units ({', '.join(sorted(units))}); use one")
    return tuple(label for label, _ in leads), units.pop()
