"""Read a text table of numbers: any usual separator, with or without names of the columns."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core import read_only_arrays
from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import UnreadableFileError

from .reading import read_text

LARGEST = 1e12
"""Largest number in a table; squares of larger ones may overflow."""
_EMPTY = {"", "nan", "na", "n/a", "null", "none", "missing"}
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_DECIMAL_COMMAS = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
_NAME = re.compile(r"(.*?)[ _]*(?:[\[(]([^\])]*)[\])]|(?<=[ _])(mm|cm|m|um|s|ms|us|ns|px|deg|rad))?")


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class NumberTable:
    """A table of numbers.

    Attributes:
        names: of the columns in lower case without their units; None if the file has no names.
        units: of the columns as their names state them ("x [m]", "t_ms"), "" if not stated.
        values: (rows, columns); NaN for empty cells and for nan, null or missing.
        lines: line number of each row in the file.
    """

    names: tuple[str, ...] | None
    units: tuple[str, ...]
    values: FloatArray
    lines: tuple[int, ...]


def read_number_table(path: Path, what: str) -> NumberTable:
    """Read a table of numbers whose rows all have the same number of cells.

    Cells are separated by semicolons, tabs, commas or blanks; with semicolons or tabs a comma is the decimal
    mark. Lines that begin with # or % are comments. A first row without any number holds the names of the
    columns; without one, so does the last comment before the numbers if it has one word a column.

    Raises:
        UnreadableFileError: absent, not a table of numbers, rows of different lengths, or commas that may be
            decimal marks or separators.
    """
    lines = [(i, line.strip(" ")) for i, line in enumerate(read_text(path, what).splitlines(), 1)]
    rows = [(i, line) for i, line in lines if line.strip() and line[0] not in "#%"]
    if not rows:
        raise UnreadableFileError(f"{path} has no rows of numbers; needed {what}")
    separator = next((mark for mark in ";\t" if any(mark in line for _, line in rows[:2])), None)
    _require_clear_commas(path, rows, separator)
    if separator is not None and all(line.endswith(separator) for _, line in rows):
        rows = [(i, line[:-1]) for i, line in rows]
    cells = [(i, _cells(line, separator)) for i, line in rows]
    names = None
    if not any(_is_number(cell) for cell in cells[0][1]) and any(cell for cell in cells[0][1]):
        names, cells = cells[0][1], cells[1:]
    elif comments := [line.lstrip("#% ") for i, line in lines if line and line[0] in "#%" and i < rows[0][0]]:
        words = _cells(comments[-1], separator if separator and separator in comments[-1] else None)
        names = words if len(words) == len(cells[0][1]) and not any(map(_is_number, words)) else None
    count = len(names or cells[0][1])
    for i, row in cells:
        if len(row) != count:
            raise UnreadableFileError(
                f"{path}, line {i}: {len(row)} cells, but {count} in the first row; needed {what}"
            )
    values = np.array([_numbers(path, i, row) for i, row in cells]).reshape(-1, count)
    parts = [_NAME.fullmatch(name.strip().strip('"').lower()) for name in names or [""] * count]
    units = tuple("" if part is None else (part[2] or part[3] or "").strip() for part in parts)
    plain = tuple("" if part is None else part[1] for part in parts)
    return NumberTable(None if names is None else plain, units, values, tuple(i for i, _ in cells))


def scaled(path: Path, table: NumberTable, columns: Sequence[int], factors: dict[str, float]) -> FloatArray:
    """Convert columns to the unit whose factor is 1, which is also that of a column without a unit.

    Raises:
        UnreadableFileError: a unit that is not among `factors`.
    """
    for column in columns:
        if table.units[column] not in ("", *factors):
            raise UnreadableFileError(
                f"{path}: column {column + 1} is in '{table.units[column]}'; needed {', '.join(factors)}"
            )
    return table.values[:, columns] * [factors.get(table.units[column], 1.0) for column in columns]


def _cells(line: str, separator: str | None) -> list[str]:
    """Split a line; a comma is the separator only if no other is in use."""
    if separator is not None:
        return [cell.strip() for cell in line.replace(",", ".").split(separator)]
    return [cell.strip() for cell in line.split(",")] if "," in line else line.split()


def _require_clear_commas(path: Path, rows: list[tuple[int, str]], separator: str | None) -> None:
    """Refuse numbers such as "1,5 2,5", which may be two or four."""
    for i, line in rows[:2] if separator is None else ():
        words = [word for word in line.split() if "," in word]
        if len(line.split()) > 1 and words and all(_DECIMAL_COMMAS.fullmatch(word) for word in words):
            raise UnreadableFileError(
                f"{path}, line {i}: '{line[:40]}' may have decimal commas, or more numbers; write decimal "
                "points"
            )


def _is_number(cell: str) -> bool:
    return cell.lower() in _EMPTY - {""} or _NUMBER.fullmatch(cell.strip('"')) is not None


def _numbers(path: Path, line: int, cells: list[str]) -> list[float]:
    values = []
    for cell in (cell.strip('"') for cell in cells):
        if cell.lower() in _EMPTY:
            values.append(math.nan)
        elif _NUMBER.fullmatch(cell) is None:
            raise UnreadableFileError(
                f"{path}, line {line}: '{cell[:40]}' is not a number; write it with a decimal point"
            )
        elif abs(float(cell)) > LARGEST:
            raise UnreadableFileError(
                f"{path}, line {line}: {cell[:40]} is beyond {LARGEST:g}; check the unit, or export it again"
            )
        else:
            values.append(float(cell))
    return values
