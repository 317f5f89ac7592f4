"""Read a text table of numbers: any usual separator, with or without names of the columns."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core import read_only_arrays
from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import UnreadableFileError

from .reading import read_text
from .table_text import parse_table

LARGEST = 1e12
"""Largest number in a table; squares of larger ones may overflow."""
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

    The parser is that of recorded signals (`table_text`); apart from comments only the names of the
    columns may come before the numbers.

    Raises:
        UnreadableFileError: absent, not a table of numbers, rows of different lengths, or commas that may be
            decimal marks or separators.
    """
    table = parse_table(path, read_text(path, what), least=1, what=what)
    if len(table.preamble) > (table.columns is not None) or table.clocks:
        line = table.preamble[0] if table.preamble else "a time of day"
        raise UnreadableFileError(f"{path}: '{line[:40]}' is not a number; needed {what}")
    for number, row in zip(table.lines, table.values, strict=True):
        if (np.abs(row) > LARGEST).any():
            raise UnreadableFileError(
                f"{path}, line {number}: a number is beyond {LARGEST:g}; check the unit, or export it again"
            )
    headings = [column.heading.lower() for column in table.columns or ()]
    parts = [_NAME.fullmatch(name) for name in headings or [""] * table.values.shape[1]]
    units = tuple("" if part is None else (part[2] or part[3] or "").strip() for part in parts)
    plain = tuple("" if part is None else part[1] for part in parts)
    return NumberTable(plain if headings else None, units, table.values, table.lines)


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
