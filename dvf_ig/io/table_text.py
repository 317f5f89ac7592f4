"""Split a text table into names, units and numbers, and read what its preamble states.

Columns of words, such as a status, are kept apart from the numbers.

A preamble is all that comes before the first row of numbers: comments, lines "key=value" or "key,value", the
names of the columns, their units. A line that is none of these is an error, as is any but numbers after it.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, UnreadableFileError, read_only_arrays

from .clock_times import clock_seconds, days_of

IN_ONE_MV = {"mv": 1.0, "millivolt": 1.0, "millivolts": 1.0, "v": 1e-3, "volt": 1e-3, "volts": 1e-3}
IN_ONE_MV |= {"uv": 1e3, "µv": 1e3, "μv": 1e3, "microvolt": 1e3, "microvolts": 1e3, "nv": 1e6}
"""How many of a unit are 1 mV."""
UNSTATED = ("", "unknown", "nu", "adu", "a.u.", "au", "n/a", "none", "-", "counts", "count", "bit", "bits")
"""Units that state no quantity, in lower case; NU is PhysioNet's "no unit"."""
IN_ONE_SECOND = {
    "s": 1.0,
    "sec": 1.0,
    "secs": 1.0,
    "second": 1.0,
    "seconds": 1.0,
    "min": 1 / 60,
    "h": 1 / 3600,
}
IN_ONE_SECOND |= {"ms": 1e3, "msec": 1e3, "us": 1e6, "µs": 1e6, "μs": 1e6, "usec": 1e6, "ns": 1e9}
MM_IN = {"mm": 1.0, "cm": 10.0, "m": 1e3}
"""Lengths of columns of positions."""
_OTHER_UNITS = re.compile(
    r"mmhg|cmh2o|kpa|mbar|%|bpm|/min|1/min|deg ?c|°?c|l/min|l/s|ml|k?ohm|k?ω|g|m/s2|hz|rpm", re.IGNORECASE
)
_BRACKETS = re.compile(r"(.*?)\s*[\[(]([^\[\]()]+)[\])]|(.*?)\s*/\s*([mµμu]?v|m?s)", re.IGNORECASE)
_SUFFIX = re.compile(r"(.*?)[_ ](s|sec|ms|us|ns|mv|uv)", re.IGNORECASE)
_KEY = re.compile(r"[A-Za-z][\w ]*=\s*\S?.*")
_RATE = re.compile(
    r"(?:(?:sampl\w*|abtast)[\s_-]*(?:rate|freq\w*|frequenz)|\bfs)\b[\s\"'_]*[\[(]?(?P<before>k?hz)?[\])]?[\s\"':=,;]*"
    r"\[?(?P<value>\d+(?:[.,]\d+)?)\s*(?P<after>khz)?",
    re.IGNORECASE,
)
_INTERVAL = re.compile(
    r"interval\W*(?P<value>\d+(?:[.,]\d+)?(?:e-?\d+)?)\s*(?P<unit>s|ms|msec|us|µs)\b"
    r"|(?P<each>\d+(?:\.\d+)?)\s*(?P<per>s|sec|ms|msec|us|usec)/sample",
    re.IGNORECASE,
)
_EMPTY = ("", "na", "n/a", "null", "none", "missing", "-", "--", "nan")
_COMMENT = ("#", "%")
_DECIMAL_COMMAS = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
_LABCHART_NAMES, _LABCHART_RANGE, _LABCHART_UNITS = "ChannelTitle=", "Range=", "UnitName="


@dataclass(frozen=True, slots=True)
class Column:
    """Name of a column without its unit, its unit, and both as the file has them; "" if it has none."""

    name: str
    unit: str = ""
    heading: str = ""

    @classmethod
    def of(cls, heading: str) -> "Column":
        """Split a heading: "time [ms]" → ("time", "ms"), "t_s" → ("t", "s"), "Lead (II)" has no unit."""
        for pattern in (_BRACKETS, _SUFFIX):
            match = pattern.fullmatch(heading)
            if match is not None:
                name, unit = (part for part in match.groups() if part is not None)
                if is_unit(unit):
                    return cls(name.strip(), unit.strip(), heading)
        return cls(heading, heading=heading)


def is_unit(text: str) -> bool:
    """Return whether a text is the unit of a column that recordings have."""
    unit = text.strip().lower()
    plain = unit in (*IN_ONE_SECOND, *IN_ONE_MV, *UNSTATED[1:])
    return plain or _OTHER_UNITS.fullmatch(unit) is not None


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Columns of a text table.

    Attributes:
        columns: None if the text does not name them.
        values: (n, columns); NaN for empty cells.
        clocks: indices of columns with times of day or elapsed times, converted to s.
        rate_hz: sampling rate that the preamble states.
        mark: mark between cells.
        lines: line number of each row.
        preamble: lines before the rows that are no comments.
        comments: lines before the rows that are comments, without their marks.
        texts: cells of each column of words, by its name; `columns` and `values` are without these.
    """

    columns: tuple[Column, ...] | None
    values: FloatArray
    clocks: tuple[int, ...]
    rate_hz: float | None
    mark: str
    lines: tuple[int, ...]
    preamble: tuple[str, ...]
    comments: tuple[str, ...] = ()
    texts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def parse_table(path: Path, text: str, *, least: int = 2, what: str = "numbers only") -> Table:
    """Parse a text table of at least `least` rows.

    Args:
        what: was needed, for messages.

    Raises:
        UnreadableFileError: a line that is not understood, commas that may be decimal marks or separators, or
            two statements of a rate that differ.
    """
    try:
        return _parsed(path, text, least, what)
    except UnreadableFileError:
        apart = _without_words(text)
        if apart is None:
            raise
    numbers, texts = apart
    table = _parsed(path, numbers, least, what)
    rows = len(table.values)
    return replace(table, texts={name: tuple(cells[-rows:]) for name, cells in texts.items()})


def _without_words(text: str) -> tuple[str, dict[str, list[str]]] | None:
    """Take the columns out of a text that mostly hold words; None if none does, or none has a name."""
    lines = text.split("\n")
    filled = [i for i, line in enumerate(lines) if line.strip()]
    if not filled:
        return None
    mark = _separator([lines[i] for i in filled if not lines[i].lstrip().startswith(_COMMENT)])
    cells = {i: _cells(lines[i].lstrip("#% \t") if i != filled[-1] else lines[i], mark) for i in filled}
    width = len(cells[filled[-1]])
    table = [i for i in filled if len(cells[i]) == width]
    rows = table[1:]
    if width < 2 or len(rows) < 2 or any(_is_plain_number(cell) for cell in cells[table[0]]):
        return None
    words = [
        at
        for at in range(width)
        if sum(not _is_number(cells[i][at], mark) for i in rows)
        > 0.5 * sum(cells[i][at].lower() not in _EMPTY for i in rows)
    ]
    if not words or len(words) == width:
        return None
    for i in table:
        lines[i] = mark.join(cell for at, cell in enumerate(cells[i]) if at not in words)
    return "\n".join(lines), {cells[table[0]][at]: [cells[i][at] for i in rows] for at in words}


def _parsed(path: Path, text: str, least: int, what: str) -> Table:
    numbered = [(n, line.rstrip(" \r")) for n, line in enumerate(text.split("\n"), 1) if line.strip()]
    forced = re.fullmatch(r'"?sep=(.)"?', numbered[0][1]) if numbered else None
    numbered = numbered[1:] if forced else numbered
    lines = [(n, line) for n, line in numbered if not line.lstrip().startswith(_COMMENT)]
    mark = forced[1] if forced else _separator([line for _, line in lines])
    first = next((i for i, (_, line) in enumerate(lines) if _is_row(line, mark)), len(lines))
    preamble, rows = lines[:first], lines[first:]
    if mark == ",":
        _require_clear_commas(path, lines)
    if mark == "," and _decimal_commas(preamble, [line for _, line in rows]):
        mark = ";"  # one column, whose commas are decimal marks
    width = len(_cells(rows[0][1], mark)) if rows else 0
    comments = [
        line.lstrip("#% \t")
        for n, line in numbered
        if line.lstrip()[0] in _COMMENT and (not rows or n < rows[0][0])
    ]
    headings, units = _headings(path, preamble, comments, mark, width, what)
    if len(rows) < least:
        count = len(rows) or "no"
        raise UnreadableFileError(f"{path} has {count} rows of numbers; needed at least {least}, {what}")
    values, clocks = _numbers(path, rows, mark, what)
    if len(headings) in (0, values.shape[1] - 1) and all(line.endswith(mark) for _, line in rows):
        values = values[:, :-1]  # a separator ends each row
    if headings and values.shape[1] != len(headings):
        raise UnreadableFileError(
            f"{path}, line {rows[0][0]}: {values.shape[1]} cells under {len(headings)} names"
        )
    columns = None
    if headings:
        units = units if len(units) == len(headings) else [""] * len(headings)
        columns = tuple(
            Column(heading, unit, f"{heading} [{unit}]") if unit else Column.of(heading)
            for heading, unit in zip(headings, units, strict=True)
        )
    stated_hz = _stated_hz(path, [*comments, *(line for _, line in preamble)])
    numbers = tuple(number for number, _ in rows)
    return Table(
        columns,
        values,
        clocks,
        stated_hz,
        mark,
        numbers,
        tuple(line for _, line in preamble),
        tuple(comments),
    )


def first_rows(text: str, rows: int) -> str | None:
    """Return the preamble and first rows of numbers of a table that grows; None if it has fewer rows yet."""
    lines = [line for line in text.split("\n") if line.strip()]
    mark = _separator([line for line in lines if not line.lstrip().startswith(_COMMENT)])
    numbers = [i for i, line in enumerate(lines) if _is_row(line, mark)][:rows]
    return "\n".join([*lines[: numbers[0]], *(lines[i] for i in numbers)]) if len(numbers) == rows else None


def numbers_of(line: str, mark: str) -> list[float]:
    """Return the numbers of a row; NaN for a cell that has none."""
    cells = _cells(line, mark)
    cells = [cell.replace(",", ".") for cell in cells] if mark != "," else cells
    return [float(cell) if _is_plain_number(cell) else np.nan for cell in cells]


def _separator(lines: list[str]) -> str:
    """Return the mark between cells: of the last rows, as a preamble may hold any."""
    ends = lines[-2:]
    for mark in ";\t":
        if ends and all(mark in line for line in ends):
            return mark
    return "," if any("," in line for line in ends) or not any(" " in line.strip() for line in ends) else " "


def _cells(line: str, mark: str) -> list[str]:
    if mark == " ":
        return [cell.strip("\"'") for cell in line.split()]
    if mark == "," and '"' in line:
        line = re.sub(r'"([^"]*)"', lambda quoted: quoted[1].replace(",", "."), line)
    return [cell.strip().strip("\"'").strip() for cell in line.split(mark)]


def _is_row(line: str, mark: str) -> bool:
    cells = _cells(line, mark)
    return all(_is_number(cell, mark) for cell in cells) and any(cell for cell in cells)


def _is_number(cell: str, mark: str) -> bool:
    try:
        float(cell.replace(",", ".") if mark != "," else cell or "nan")
    except ValueError:
        return cell.lower() in _EMPTY or clock_seconds(cell) is not None
    return True


def _decimal_commas(preamble: list[tuple[int, str]], rows: list[str]) -> bool:
    """Return whether each row's one comma is a decimal mark: under one name, or before digits like 05."""
    if not rows or any(row.count(",") != 1 or "." in row for row in rows[:1000]):
        return False
    if preamble:
        return "," not in preamble[-1][1]
    return any(re.search(r",0\d|^\s*-0,", row) for row in rows)


def _require_clear_commas(path: Path, lines: list[tuple[int, str]]) -> None:
    """Refuse numbers such as "1,5 2,5", which may be two or four."""
    for i, line in lines[:2]:
        words = [word for word in line.split() if "," in word]
        if len(line.split()) > 1 and words and all(_DECIMAL_COMMAS.fullmatch(word) for word in words):
            raise UnreadableFileError(
                f"{path}, line {i}: '{line[:40]}' may have decimal commas, or more numbers; write decimal "
                "points"
            )


def _headings(
    path: Path, preamble: list[tuple[int, str]], comments: list[str], mark: str, width: int, what: str
) -> tuple[list[str], list[str]]:
    """Return the names of the columns and their units, each empty if the text has none."""
    headings, units = list[str](), list[str]()
    for number, line in preamble:
        cells = _cells(line, mark)
        if line.startswith((_LABCHART_NAMES, _LABCHART_UNITS, _LABCHART_RANGE)):
            tail = [cell for cell in cells[1:] if cell]
            times = ["time [s]"] * (width - len(tail))
            if line.startswith(_LABCHART_NAMES):
                headings = [*times, *tail]
            elif not any(units) or line.startswith(_LABCHART_UNITS):
                units = [*("s" for _ in times), *(cell.split()[-1] for cell in tail)]
        elif _KEY.fullmatch(line) or _RATE.search(line) or _INTERVAL.search(line):
            continue
        elif len(cells) == 2 and width == 1 and not headings:
            if cells[0].lower() == "unit":
                units = [cells[1]]
            elif cells[0].lower() == "lead":
                comments.append(cells[1])
        elif len(cells) == 1 and width > 1 and not headings:
            continue  # a title
        elif any(_is_plain_number(cell) for cell in cells) or units:
            raise _not_numbers(path, number, line, what)
        elif not headings:
            headings = cells
        elif len(cells) == len(headings):
            units = [cell if is_unit(cell) else "" for cell in cells]
        else:
            raise _not_numbers(path, number, line, what)
    if not headings and comments and width:
        last = comments[-1].split() if mark == " " else _cells(comments[-1], mark)
        last = last if len(last) == width else comments[-1].split()
        if len(last) == width and not any(_is_plain_number(cell) for cell in last):
            headings = last
    if not headings and width == 1 and units:
        headings = comments[-1:] or ["ECG"]
    described = next((names for text in comments if (names := _open_signals(text)) is not None), None)
    if described is not None and len(described) in (width, width - 1):
        headings = described
    return headings, units


def _open_signals(text: str) -> list[str] | None:
    """Return the columns, by their sensors, that a JSON comment of OpenSignals lists; None for other text."""
    try:
        devices = list(json.loads(text).values())
        names = [str(name) for name in devices[0]["column"]]
        sensors = [str(name) for name in devices[0]["sensor"]]
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None
    channels = len(names) - len(sensors)
    return names if channels < 0 else [*names[:channels], *sensors]


def _is_plain_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _not_numbers(path: Path, number: int, line: str, what: str = "numbers only") -> UnreadableFileError:
    return UnreadableFileError(f"{path}, line {number}: '{line.strip()[:60]}'; needed {what}")


def _numbers(
    path: Path, rows: list[tuple[int, str]], mark: str, what: str
) -> tuple[FloatArray, tuple[int, ...]]:
    """Parse the rows, and return (n, columns) values and the columns of times of day."""
    texts = (
        [re.sub(r"\s*\t#.*", "", line) for _, line in rows] if mark == "\t" else [line for _, line in rows]
    )
    if mark == " ":
        texts, mark = ["\t".join(line.split()) for line in texts], "\t"
    clocks = tuple(i for i, cell in enumerate(_cells(texts[0], mark)) if _is_clock(cell))
    if clocks or any('"' in text for text in texts[:2]):
        split = [_cells(text, mark) for text in texts]
        for at in clocks:
            _convert_clock(path, rows, split, at)
        texts = [mark.join(cells) for cells in split]
    if mark != ",":
        texts = [text.replace(",", ".") for text in texts]
    empty = re.compile(rf"(?:(?<={mark})|^) *(?:n/?a|null|none|missing|--?)? *(?={mark}|$)", re.IGNORECASE)
    several = mark in texts[0]
    texts = [empty.sub("nan", text).replace('"', "") if several else text for text in texts]
    try:
        return np.loadtxt(texts, delimiter=mark, ndmin=2), clocks
    except ValueError as exc:
        width = texts[0].count(mark)
        for (number, line), text in zip(rows, texts, strict=True):
            if text.count(mark) != width:
                raise UnreadableFileError(
                    f"{path}, line {number}: {text.count(mark) + 1} cells, but {width + 1} in the first row"
                ) from exc
            if not all(_is_plain_number(cell) for cell in text.split(mark)):
                raise _not_numbers(path, number, line, what) from exc
        raise UnreadableFileError(f"{path}: {str(exc).split(';')[0]}; needed {what}") from exc


def _is_clock(cell: str) -> bool:
    return not _is_plain_number(cell) and clock_seconds(cell) is not None


def _convert_clock(path: Path, rows: list[tuple[int, str]], split: list[list[str]], at: int) -> None:
    """Replace times of day by seconds, and refuse dates that jump."""
    for (number, line), cells in zip(rows, split, strict=True):
        seconds = clock_seconds(cells[at]) if len(cells) > at else None
        if seconds is None:
            cell = cells[at] if len(cells) > at else line
            raise UnreadableFileError(f"{path}, line {number}: '{cell[:40]}' is no time like those before")
    dates = [days_of(cells[at]) for cells in split]
    times = [clock_seconds(cells[at]) or 0.0 for cells in split]
    for (one, other), (before, after), (number, _) in zip(
        pairwise(dates), pairwise(times), rows[1:], strict=True
    ):
        if one != other and after >= before:
            raise UnreadableFileError(
                f"{path}, line {number}: the date changes from '{one}' to '{other}' within a day; export one "
                "recording"
            )
    for cells, seconds in zip(split, times, strict=True):
        cells[at] = repr(seconds)


def _stated_hz(path: Path, lines: list[str]) -> float | None:
    """Return the sampling rate that the preamble states."""
    rates: list[float] = []
    for line in lines:
        for match in _RATE.finditer(line):
            kilo = "k" in ((match["before"] or "") + (match["after"] or "")).lower()
            rates.append(float(match["value"].replace(",", ".")) * (1000.0 if kilo else 1.0))
        for match in _INTERVAL.finditer(line):
            value = float((match["value"] or match["each"]).replace(",", "."))
            unit = (match["unit"] or match["per"]).lower()
            rates.append(IN_ONE_SECOND[unit] / value if value else 0.0)
    if not rates:
        return None
    if max(rates) - min(rates) > 1e-3 * max(rates):
        raise UnreadableFileError(
            f"{path} states two sampling rates, {min(rates):g} and {max(rates):g} Hz; correct its header"
        )
    return rates[0]
