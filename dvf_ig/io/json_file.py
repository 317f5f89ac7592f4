"""JSON files: strict (no NaN on disk), atomic; numpy values and frozen results become plain ones."""

import dataclasses
import enum
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core.errors import OutputError, UnreadableFileError

from .reading import read_text
from .writing.atomic import write_text


def write_json(path: Path | str, value: Any) -> None:
    """Write `value` as JSON, atomically.

    Arrays become lists, enums their value, dataclasses objects, paths strings; NaN and infinity become null
    because JSON has no word for them. Floats keep every digit.

    Raises:
        OutputError: not writable, or a value that JSON cannot hold.
    """
    write_text(Path(path), json.dumps(plain(value), indent=1, allow_nan=False, ensure_ascii=False) + "\n")


def read_json(path: Path | str, what: str = "a JSON file") -> Any:
    """Parse a JSON file.

    Raises:
        UnreadableFileError: absent, or not JSON; the message gives the line.
    """
    path = Path(path)
    text = read_text(path, what)
    try:
        return json.loads(text)
    except json.JSONDecodeError as exc:
        raise UnreadableFileError(f"{path} is not {what}: line {exc.lineno}: {exc.msg}") from exc
    except ValueError as exc:
        raise UnreadableFileError(f"{path} is not {what}: it holds a number of too many digits") from exc
    except RecursionError as exc:
        raise UnreadableFileError(f"{path} is not {what}: it is nested too deeply") from exc


def plain(value: Any) -> Any:
    """`value` in lists, dicts, strings, numbers, booleans and None."""
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, enum.Enum):
        return plain(value.value)
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, Path):
        return str(value)
    raise OutputError(f"cannot write a {type(value).__name__} as JSON; give numbers, text, lists or arrays")
