"""The table of ticks that a replay left, row by row."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from dvf_ig.core import FloatArray, UnreadableFileError, read_only_arrays
from dvf_ig.io.reading import reading


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TickRow:
    """What the session said at `t_s`.

    Attributes:
        tip_mr_mm: (3,) NaN where it is not known.
        force_tracker_n: (3,) sent.
        numbers: those named in NUMBERS; NaN where there is none.
        status, supervisor, hazards: words.
    """

    NUMBERS: ClassVar[tuple[str, ...]] = ("phi", "model_phase", "rr_s", "distance_mm", "pose_age_s")

    t_s: float
    tip_mr_mm: FloatArray
    force_tracker_n: FloatArray
    numbers: FloatArray
    status: str
    supervisor: str
    hazards: str


def read_ticks(path: Path) -> Iterator[TickRow]:
    """Every row of `ticks.csv`.

    Raises:
        UnreadableFileError: absent, or not such a table.
    """
    with reading(path, "the ticks of a replay"), path.open(newline="", encoding="utf-8") as stream:
        rows = csv.reader(stream)
        names = next(rows, [])
        try:
            at = {name: names.index(name) for name in _NEEDED}
            for row in rows:
                yield _row(row, at)
        except (ValueError, IndexError) as exc:
            raise UnreadableFileError(f"{path} is not the table of a replay ({exc}); replay again") from exc


_TIP = tuple(f"tip_mr_{axis}_mm" for axis in "xyz")
_FORCE = tuple(f"force_tracker_{axis}_n" for axis in "xyz")
_NEEDED = ("t_s", *_TIP, *_FORCE, *TickRow.NUMBERS, "status", "supervisor", "hazards")


def _row(row: list[str], at: dict[str, int]) -> TickRow:
    def numbers(names: tuple[str, ...]) -> FloatArray:
        return np.array([float(row[at[name]] or "nan") for name in names])

    return TickRow(
        float(row[at["t_s"]]),
        numbers(_TIP),
        numbers(_FORCE),
        numbers(TickRow.NUMBERS),
        row[at["status"]],
        row[at["supervisor"]],
        row[at["hazards"]],
    )
