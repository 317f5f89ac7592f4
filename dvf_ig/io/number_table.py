"""Read a text table of numbers: any usual separator, with or without names of the columns."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dvf_ig.core import FloatArray, UnreadableFileError, read_only_arrays

from .clock_times import past_midnight
from .reading import read_text
from .table_text import IN_ONE_SECOND, parse_table

_BAD_FLOAT = -3.697314e28
"""Number that trackers of NDI give for a value that they could not measure."""
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
        comments: lines before the rows that are comments, without their marks.
        texts: cells of each column of words, by its name in lower case.
    """

    names: tuple[str, ...] | None
    units: tuple[str, ...]
    values: FloatArray
    lines: tuple[int, ...]
    comments: tuple[str, ...] = ()
    texts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def read_number_table(path: Path, what: str) -> NumberTable:
    """Read a table of numbers whose rows all have the same number of cells.

    The parser is that of recorded signals (`table_text`); apart from comments only the names of the
    columns may come before the numbers.

    Raises:
        UnreadableFileError: absent, not a table of numbers, rows of different lengths, or commas that may be
            decimal marks or separators.
    """
    table = parse_table(path, read_text(path, what), least=1, what=what)
    if len(table.preamble) > (table.columns is not None):
        raise UnreadableFileError(f"{path}: '{table.preamble[0][:40]}' is not a number; needed {what}")
    headings = [column.heading.lower() for column in table.columns or ()]
    parts = [_NAME.fullmatch(name) for name in headings or [""] * table.values.shape[1]]
    units = ["" if part is None else (part[2] or part[3] or "").strip() for part in parts]
    values = np.where(np.isclose(table.values, _BAD_FLOAT, rtol=1e-6), np.nan, table.values)
    for at in table.clocks:
        values[:, at], units[at] = past_midnight(values[:, at]), "s"
    lengths = [at for at, unit in enumerate(units) if unit not in IN_ONE_SECOND]
    for number, row in zip(table.lines, values[:, lengths], strict=True):
        if (np.abs(row) > LARGEST).any():
            raise UnreadableFileError(
                f"{path}, line {number}: a number is beyond {LARGEST:g}; check the unit (times in ns: name "
                "their column t_ns), or export it again"
            )
    plain = tuple("" if part is None else part[1] for part in parts)
    texts = {name.lower(): cells for name, cells in table.texts.items()}
    return NumberTable(plain if headings else None, tuple(units), values, table.lines, table.comments, texts)


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
