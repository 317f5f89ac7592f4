"""Read an ECG from a text table: one row per sample, any usual separator, optional header and times."""

import gzip
import io
import logging
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray, Signal, UnreadableFileError
from dvf_ig.core.plausible import ECG_RATE_HZ, ECG_SWING_MV
from dvf_ig.io import limits
from dvf_ig.io.clock_times import past_midnight
from dvf_ig.io.json_file import read_json
from dvf_ig.io.reading import decode_text, read_bytes, read_text
from dvf_ig.io.table_text import IN_ONE_MV, IN_ONE_SECOND, Column, Table, numbers_of, parse_table

from .leads import UNKNOWN_UNIT, Channel, choose_leads, in_millivolts, swing_of
from .pmu_log import is_pmu_log, read_pmu_log

log = logging.getLogger(__name__)

_TIME_NAMES = ("t", "time", "times", "timestamp", "timestamps", "elapsed time", "elapsed", *IN_ONE_SECOND)
_TIME_WORDS = {
    "time",
    "timestamp",
    "timestamps",
    "elapsed",
    "zeit",
    "uhrzeit",
    "zeitstempel",
    "temps",
    "tiempo",
    "datetime",
}
_COUNT_NAMES = {
    "sample",
    "samples",
    "sample #",
    "index",
    "sample index",
    "sample number",
    "nseq",
    "no",
    "no.",
    "#",
}
_SHORTEST_STEP_S, _LONGEST_STEP_S = 1 / ECG_RATE_HZ[1], 1 / ECG_RATE_HZ[0]
_LATEST = 1e19
"""Largest plausible time: nanoseconds since 1970 reach 1.8e18."""
_FEWEST_SAME, _FAR = 3, 20.0
"""Samples of one value, and its distance in ranges of all others, from which it means missing ones."""
_AGREES = 0.01
"""Largest relative difference between the rate of rounded times and a stated rate."""


def read_ecg_table(path: Path, rate_hz: float | None = None, lead: str | None = None) -> Signal:
    """Read an ECG from a text table, one row per sample, or from a log of a Siemens scanner (`read_pmu_log`).

    Cells are separated by commas, semicolons, tabs or blanks; with semicolons, tabs or one column alone a
    comma may be the decimal mark. A header names the columns, `t_s,II,V1` or `Timestamp;ECG (mV)`; a second
    row may hold their units; lines above it may state the sampling rate (LabChart, OpenSignals, Apple). A
    table of BIDS has its names and rate in a JSON file of the same name. Times are in a column named t, time
    or timestamp, or in a first column that always increases; their unit is the one in its name (`t_ms`,
    `time [ms]`), else the one of s, ms, µs and ns that gives 20 Hz or more. Times of day and elapsed times
    (13:59:50.004, 30.03.2024 01:59:50 PM, 0:02.778) become seconds since midnight or since the start. Leads
    are chosen by name and unit (`choose_leads`), and are in mV unless their names say otherwise.

    Args:
        path: the file, which gzip may have packed.
        rate_hz: sampling rate of a table without times; sample 0 is then at 0 s.
        lead: names of the leads to take instead, separated by commas.
    Raises:
        UnreadableFileError: absent, no table of numbers, neither times nor a rate, unevenly sampled, no ECG,
            or two of times, stated rate and `rate_hz` that contradict each other.
    """
    text = _text(path)
    if is_pmu_log(text):
        return read_pmu_log(path, text, rate_hz)
    table, start_s = _with_sidecar(path, parse_table(path, text))
    columns, times, others = _channels(table)
    _leave_out_words(path, table)
    chosen = _leads(path, columns, others, lead)
    labels = tuple(columns[i].name for i in chosen)
    recorded = _without_placeholders(path, table.values[:, chosen])
    samples, unit = _in_one_unit(path, recorded, [columns[i] for i in chosen])
    stated_hz = _agreed(path, table.rate_hz, rate_hz)
    if times:
        t_s, measured_hz = _even_times(path, table, columns, times)
        if stated_hz is not None and abs(stated_hz - measured_hz) > _AGREES * measured_hz:
            whose = (
                f"--rate is {rate_hz:g} Hz; omit it"
                if rate_hz is not None
                else f"its header states {stated_hz:g} Hz"
            )
            raise UnreadableFileError(f"{path}: its times are at {measured_hz:.4g} Hz, but {whose}")
        start_s, stated_hz = float(t_s[0]), stated_hz or measured_hz
    if stated_hz is None:
        listed = ", ".join(column.name for column in columns)[:60]
        raise UnreadableFileError(
            f"{path} has no column of times (named t_s, time or timestamp) among {listed}; give its sampling "
            "rate in Hz",
            settings=("ecg.rate_hz",),
        )
    if unit == "mV" and not any(columns[i].unit for i in chosen) and _are_counts(samples, stated_hz):
        log.warning("%s states no unit, and its numbers are too large for mV: they are read as counts", path)
        unit = UNKNOWN_UNIT
    left_out = tuple(columns[i].name for i in others if i not in chosen)
    return Signal(samples, stated_hz, start_s, labels, unit, left_out)


@dataclass(frozen=True, slots=True)
class LeadColumns:
    """Columns of the ECG leads in a table that grows, whose first rows are known.

    Attributes:
        mark: mark between cells.
        width: number of cells in a row.
        chosen: indices of the leads.
    """

    mark: str
    width: int
    chosen: tuple[int, ...]

    @classmethod
    def of(cls, path: Path, head: str, lead: str | None) -> "LeadColumns":
        """Choose the leads as `read_ecg_table` does.

        Args:
            path: the file, for messages.
            head: preamble and first rows (`first_rows`).
            lead: names of the leads to take instead, separated by commas.
        Raises:
            UnreadableFileError: no table of numbers, or no ECG among its columns.
        """
        table = parse_table(path, head)
        if table.texts:
            raise UnreadableFileError(
                f"{path}: the columns {', '.join(table.texts)} hold words; needed numbers only in a table "
                "that grows"
            )
        columns, _, others = _channels(table)
        return cls(table.mark, len(columns), tuple(_leads(path, columns, others, lead)))

    def samples(self, lines: Sequence[str]) -> FloatArray:
        """Return (n, leads) samples of rows; NaN for a row that is not one, as a gap keeps its time."""
        samples = np.full((len(lines), len(self.chosen)), np.nan)
        for i, line in enumerate(lines):
            numbers = numbers_of(line, self.mark)
            if len(numbers) == self.width:
                samples[i] = [numbers[at] for at in self.chosen]
        return samples


def _channels(table: Table) -> tuple[tuple[Column, ...], list[int], list[int]]:
    """Return the columns, those of times, and those that may be leads."""
    columns = table.columns or tuple(Column(f"column {i + 1}") for i in range(table.values.shape[1]))
    empty = [i for i, column in enumerate(columns) if not column.name and np.isnan(table.values[:, i]).all()]
    times, counts = _time_columns(table), _count_column(table)
    return columns, times, [i for i in range(len(columns)) if i not in (*times, counts, *empty)]


def _leave_out_words(path: Path, table: Table) -> None:
    """Log the columns of words.

    Raises:
        UnreadableFileError: one of them is named as times or a lead.
    """
    for name, cells in table.texts.items():
        column = Column.of(name)
        if _is_time(column) or Channel(column.name, column.unit).kind == "ecg":
            raise UnreadableFileError(f"{path}: column '{name}' holds '{cells[0][:40]}'; needed numbers only")
    if table.texts:
        log.warning("%s: the columns %s hold words and are left out", path, ", ".join(table.texts))


def _leads(path: Path, columns: Sequence[Column], others: list[int], lead: str | None) -> list[int]:
    """Choose the columns that are ECG leads."""
    channels = [Channel(columns[i].name, columns[i].unit) for i in others]
    return [others[i] for i in choose_leads(path, channels, lead)]


def _text(path: Path) -> str:
    """Read the text of a table, which gzip may have packed."""
    if not path.name.lower().endswith(".gz"):
        return read_text(path, "an ECG table")
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(read_bytes(path, "an ECG table"))) as packed:
            data = packed.read(limits.TEXT_BYTES + 1)
    except (OSError, EOFError, zlib.error) as exc:
        raise UnreadableFileError(f"{path} is not a whole gzip file ({exc}); copy it again") from exc
    if len(data) > limits.TEXT_BYTES:
        raise UnreadableFileError(f"{path} unpacks to more than {limits.TEXT_BYTES} bytes; split it")
    return decode_text(data)[0]


def _with_sidecar(path: Path, table: Table) -> tuple[Table, float]:
    """Add what the JSON file of a BIDS recording states, and return the table with the time of its first row.

    Source: BIDS 1.10, "Physiological recordings".
    """
    name = path.name[: -len(".gz")] if path.name.lower().endswith(".gz") else path.name
    sidecar = path.with_name(f"{name[: -len('.tsv')]}.json")
    if not name.lower().endswith(".tsv") or not sidecar.is_file():
        return table, 0.0
    stated: Any = read_json(sidecar, "the description of a BIDS recording")
    stated = stated if isinstance(stated, dict) else {}
    names, hz, start_s = (stated.get(key) for key in ("Columns", "SamplingFrequency", "StartTime"))
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in (hz, start_s or 0))
    if not isinstance(names, list) or not numbers or not 0 < float(hz) < 1e6:
        raise UnreadableFileError(
            f"{sidecar} does not describe {path.name}: needed a SamplingFrequency in Hz, Columns, and "
            "StartTime in s"
        )
    if len(names) != table.values.shape[1]:
        raise UnreadableFileError(
            f"{path} has {table.values.shape[1]} columns, but {sidecar.name} names {len(names)}; correct one"
        )
    headings = [str(column) for column in names]
    if table.columns is not None and [column.name for column in table.columns] != headings:
        raise UnreadableFileError(
            f"{path}: its header and {sidecar.name} name different columns; correct one"
        )
    described = (stated.get(heading) for heading in headings)
    units = [str(entry.get("Units", "")) if isinstance(entry, dict) else "" for entry in described]
    columns = tuple(Column(heading, unit) for heading, unit in zip(headings, units, strict=True))
    return replace(table, columns=columns, rate_hz=_agreed(path, table.rate_hz, float(hz))), float(
        start_s or 0.0
    )


def _agreed(path: Path, stated_hz: float | None, rate_hz: float | None) -> float | None:
    """Return the rate that the file states, or else the user.

    Raises:
        UnreadableFileError: both do, and differ.
    """
    if stated_hz is not None and rate_hz is not None and abs(stated_hz - rate_hz) > 1e-3 * stated_hz:
        raise UnreadableFileError(f"{path} states {stated_hz:g} Hz, but --rate is {rate_hz:g} Hz; omit it")
    return stated_hz if stated_hz is not None else rate_hz


def _time_columns(table: Table) -> list[int]:
    """List the columns of times, the best first: by name, by form; else the first of several columns if it
    always increases and is not a sample count.
    """
    columns = table.columns or ()
    exact = [i for i, column in enumerate(columns) if column.name.lower() in _TIME_NAMES]
    similar = [i for i, column in enumerate(columns) if _is_time(column)]
    times = list(dict.fromkeys((*exact, *similar, *table.clocks)))
    if times:
        return times
    first = table.values[:, 0]
    increases = table.values.shape[1] > 1 and bool((np.diff(first) > 0).all())
    is_lead = bool(columns) and Channel(columns[0].name, columns[0].unit).kind != "unknown"
    return [0] if increases and not is_lead and _count_column(table) is None else []


def _is_time(column: Column) -> bool:
    """Return whether a column is named as times."""
    words = set(column.name.lower().replace("_", " ").split())
    return column.name.lower() in _TIME_NAMES or bool(
        _TIME_WORDS & words and column.unit.lower() not in IN_ONE_MV
    )


def _count_column(table: Table) -> int | None:
    """Find the column of sample numbers: by name, or a first column n, n+1, … that is not named as a time."""
    for i, column in enumerate(table.columns or ()):
        if column.name.lower() in _COUNT_NAMES:
            return i
    numbered = table.values.shape[1] > 1 and bool((np.diff(table.values[:, 0]) == 1).all())
    timed = 0 in table.clocks or (table.columns is not None and _is_time(table.columns[0]))
    return 0 if numbered and not timed else None


def _even_times(
    path: Path, table: Table, columns: Sequence[Column], times: list[int]
) -> tuple[FloatArray, float]:
    """Return times in s and rate of the first column of even times; other even ones must have its rate."""
    even: list[tuple[int, FloatArray, float]] = []
    problem: UnreadableFileError | None = None
    for at in times:
        try:
            t_s = _seconds(path, table, columns[at], at)
            even.append((at, t_s, even_rate_hz(path, t_s)))
        except UnreadableFileError as exc:
            problem = problem or exc
    if not even:
        raise problem or UnreadableFileError(f"{path} has no times")
    best, t_s, rate_hz = even[0]
    for at, _, other_hz in even[1:]:
        if abs(other_hz - rate_hz) > _AGREES * rate_hz:
            raise UnreadableFileError(
                f"{path}: column '{columns[best].name}' has {rate_hz:.4g} samples per second, column "
                f"'{columns[at].name}' {other_hz:.4g}; remove the wrong one"
            )
    if problem is not None:
        log.warning("%s: times are those of column '%s'", path, columns[best].name)
    return t_s, rate_hz


def _seconds(path: Path, table: Table, column: Column, at: int) -> FloatArray:
    """Convert the times to s with the unit of the column, else the one that fits their steps."""
    times, name = table.values[:, at], column.name
    if (np.abs(times) > _LATEST).any():
        raise UnreadableFileError(
            f"{path}: its times reach {np.nanmax(np.abs(times)):.3g}; needed times in s, ms, µs or ns"
        )
    if at in table.clocks:
        return past_midnight(times)
    stated = (column.unit or name).lower()
    step = float(np.median(np.diff(times)))
    if stated in IN_ONE_SECOND:
        step_s = step / IN_ONE_SECOND[stated]
        if step_s > _LONGEST_STEP_S or 0 < step_s < _SHORTEST_STEP_S * (1 - 1e-9):
            raise UnreadableFileError(
                f"{path}: its times step by {step:g} {stated} (column '{column.heading}'); no ECG is sampled "
                f"at {1 / step_s:.3g} Hz: correct the unit in the header"
            )
        return times / IN_ONE_SECOND[stated]
    for unit in ("s", "ms", "us", "ns"):
        step_s = step / IN_ONE_SECOND[unit]
        if step_s <= _LONGEST_STEP_S:
            if 0 < step_s < _SHORTEST_STEP_S * (1 - 1e-9):
                break
            if unit != "s":
                log.warning("%s: its times step by %g, so they are read as %s", path, step, unit)
            return times / IN_ONE_SECOND[unit]
    raise UnreadableFileError(f"{path}: times step by {step:g}; name their unit in the header, as in t_ms")


def _without_placeholders(path: Path, samples: FloatArray) -> FloatArray:
    """Return (n, leads) samples with NaN for a number such as -9999 that means missing ones.

    It is the smallest or largest of its lead, repeats exactly, and is far beyond the range of all others.
    """
    cleared = np.array(samples)
    for lead in cleared.T:
        for value in (np.nanmin(lead, initial=np.inf), np.nanmax(lead, initial=-np.inf)):
            same, others = lead == value, lead[np.isfinite(lead) & (lead != value)]
            if same.sum() < _FEWEST_SAME or not len(others):
                continue
            middle = float(np.median(others))
            if abs(value - middle) > _FAR * float(np.ptp(others)) > 0:
                log.warning("%s: %d samples are %g and are taken as missing", path, same.sum(), value)
                lead[same] = np.nan
    return cleared


def _are_counts(samples: FloatArray, rate_hz: float) -> bool:
    """Return whether (n, leads) samples are whole numbers that swing by more than a heart's mV."""
    whole = bool((samples == np.rint(samples))[np.isfinite(samples)].all())
    return whole and max(swing_of(lead, rate_hz) for lead in samples.T) > ECG_SWING_MV[1]


def _in_one_unit(path: Path, samples: FloatArray, columns: list[Column]) -> tuple[FloatArray, str]:
    """Return (n, leads) samples in the unit that all columns share, else in mV, which none states as well."""
    units = {column.unit.lower() for column in columns}
    if units == {""}:
        return samples, "mV"
    if "" in units:
        listed = ", ".join(sorted({column.unit or "none" for column in columns}))
        raise UnreadableFileError(f"{path}: leads in different units ({listed}); name the unit of each")
    if len(units) == 1 and units <= set(IN_ONE_MV):
        unit = columns[0].unit
        return samples, "mV" if unit.lower() == "mv" else unit
    return in_millivolts(path, samples, [Channel(column.name, column.unit) for column in columns])


def even_rate_hz(path: Path, t_s: FloatArray) -> float:
    """Estimate the sampling rate of evenly spaced times: the roundest one that gives exactly these times.

    Raises:
        UnreadableFileError: a time is not finite, repeats, or is more than half a sample out of step.
    """
    steps = np.diff(t_s)
    step = float(np.median(steps))
    if step == 0:
        raise UnreadableFileError(
            f"{path}: most times repeat; they are written too coarsely, leave their column "
            "out and give the sampling rate in Hz",
            settings=("ecg.rate_hz",),
        )
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
    """List the floats closest to `value`, nearest first."""
    up, down, out = value, value, [value]
    for _ in range(count):
        up, down = float(np.nextafter(up, np.inf)), float(np.nextafter(down, 0.0))
        out += [up, down]
    return out
