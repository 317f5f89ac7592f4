"""Reading of a replay's folder: result, ticks and the reference to its recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.cardiac.respiration import BreathState
from dvf_ig.core import InvalidInputError, UnreadableFileError, read_only_arrays
from dvf_ig.core.arrays import AnyArray
from dvf_ig.guidance import Hazard, Status, SupervisorState
from dvf_ig.io import read_json
from dvf_ig.session import UNFOLLOWED

from .outputs import COLUMNS, TICKS
from .result.result import SCHEMA
from .view_file import ViewFile, read_view_file

RESULT = "result.json"


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RunFolder:
    """Folder that `dvf-ig replay` wrote.

    Attributes:
        folder: path of the folder.
        result: content of `result.json`.
        ticks: columns of `ticks.csv` by name; words as their codes, hazards as bits, empty cells as NaN.
        view: content of `view.json`.
    """

    folder: Path
    result: dict[str, Any]
    ticks: dict[str, AnyArray]
    view: ViewFile


def read_run(folder: Path) -> RunFolder:
    """Read a replay's folder.

    Raises:
        UnreadableFileError: no such folder, or a file of it is missing, damaged or of another version.
    """
    if not (folder / RESULT).is_file():
        raise UnreadableFileError(
            f"{folder} holds no {RESULT}; give the folder that dvf-ig replay … -o wrote"
        )
    result = read_json(folder / RESULT, "a replay's result")
    if not isinstance(result, dict) or result.get("schema") != SCHEMA:
        raise UnreadableFileError(f"{folder / RESULT} is not of a replay ({SCHEMA})")
    return RunFolder(folder, result, read_ticks(folder / TICKS), read_view_file(folder))


def require_same_recording(result: dict[str, Any], folder: Path, inputs: Sequence[Mapping[str, Any]]) -> None:
    """Raise InvalidInputError if a file of the recording differs from the one behind the result.

    Args:
        result: result of the folder.
        inputs: files read for the recording, with SHA-256.
    """
    before = {Path(one["file"]).name: one["sha256"] for one in result.get("inputs", [])}
    for one in inputs:
        name = Path(one["file"]).name
        if name in before and before[name] != one["sha256"]:
            raise InvalidInputError(
                f"the recording is not the one that {folder} was made from: {name} differs; run it again, or "
                "give the old one with --recording"
            )


def read_ticks(path: Path) -> dict[str, AnyArray]:
    """Read the columns of `ticks.csv` by name.

    Raises:
        UnreadableFileError: absent, damaged, or written by another version.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as exc:
        raise UnreadableFileError(f"cannot read {path}: {exc}; replay again") from exc
    names = [name for name, _ in COLUMNS]
    if not lines or lines[0].split(",") != names or len(lines) < 2:
        raise UnreadableFileError(f"{path} does not hold the columns of this version; replay again")
    cells = [line.split(",") for line in lines[1:]]
    if any(len(row) != len(names) for row in cells):
        raise UnreadableFileError(f"{path} has rows of other lengths than its first line; replay again")
    try:
        return {
            name: _column(name, column) for name, column in zip(names, zip(*cells, strict=True), strict=True)
        }
    except (KeyError, ValueError) as exc:
        raise UnreadableFileError(f"{path} is damaged ({exc}); replay again") from exc


def _column(name: str, cells: tuple[str, ...]) -> AnyArray:
    if name == "status":
        return _codes(cells, lambda word: int(Status[word.upper()]))
    if name == "supervisor":
        return _codes(cells, lambda word: int(SupervisorState[word.upper()]))
    if name == "breath_state":
        return _codes(cells, lambda word: int(BreathState[word.upper()]) if word else UNFOLLOWED)
    if name == "hazards":
        return _codes(cells, _bits)
    return np.array([cell or "nan" for cell in cells]).astype(np.float64)


def _codes(cells: tuple[str, ...], code: Any) -> AnyArray:
    table = {word: code(word) for word in set(cells)}
    return np.array([table[word] for word in cells], dtype=np.float64)


def _bits(words: str) -> int:
    return sum(int(Hazard[word.upper()]) for word in words.split("|") if word)
