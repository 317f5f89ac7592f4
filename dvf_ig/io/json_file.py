"""Read and write strict JSON (no NaN, no repeated name); numpy values and results become plain ones."""

import dataclasses
import enum
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core.errors import OutputError, UnreadableFileError

from .provenance import MARK, provenance_fields
from .reading import read_text
from .writing.atomic import write_text


def write_json(path: Path | str, value: Any) -> None:
    """Write `value` as JSON, atomically.

    Arrays become lists, enums their value, dataclasses objects, paths strings; NaN and infinity become null
    because JSON cannot express them. Floats keep every digit.

    Raises:
        OutputError: not writable, or a value that JSON cannot hold.
    """
    write_text(Path(path), json.dumps(plain(value), indent=1, allow_nan=False, ensure_ascii=False) + "\n")


def write_sidecar(path: Path, content: Mapping[str, Any], kind: str) -> None:
    """Write a result as JSON with our mark, its kind and its provenance (see `provenance_fields`).

    Args:
        kind: of the content, for example "transform".
    Raises:
        OutputError: not writable.
    """
    write_json(path, {**plain({**content, **provenance_fields()}), "kind": kind, "written_by": MARK})


def read_json(path: Path | str, what: str = "a JSON file") -> Any:
    """Parse a JSON file.

    Raises:
        UnreadableFileError: absent, not JSON, or ambiguous JSON (`parse_json`); the message gives the line.
    """
    path = Path(path)
    text = read_text(path, what)
    try:
        return parse_json(text)
    except _AmbiguousError as exc:
        raise UnreadableFileError(f"{path}: {exc}") from exc
    except json.JSONDecodeError as exc:
        raise UnreadableFileError(f"{path} is not {what}: line {exc.lineno}: {exc.msg}") from exc
    except ValueError as exc:
        raise UnreadableFileError(f"{path} is not {what}: it holds a number of too many digits") from exc
    except RecursionError as exc:
        raise UnreadableFileError(f"{path} is not {what}: it is nested too deeply") from exc


def parse_json(text: str) -> Any:
    """Parse JSON that every program reads identically: no repeated name, no NaN, no infinity.

    Raises:
        ValueError: not such JSON.
    """
    try:
        return json.loads(text, object_pairs_hook=_object, parse_constant=_refused_constant)
    except _AmbiguousError:
        raise _ambiguity(text) from None


class _AmbiguousError(ValueError):
    """Repeated name in an object, or a number that JSON does not have."""


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    document = dict(pairs)
    if len(document) != len(pairs):
        raise _AmbiguousError
    return document


def _refused_constant(name: str) -> Any:
    raise _AmbiguousError


_TOKEN = re.compile(r'("(?:[^"\\]|\\.)*")(\s*:)?|[{}]|-?(?:NaN|Infinity)', re.DOTALL)


def _ambiguity(text: str) -> _AmbiguousError:
    """Describe the first ambiguity in a text that is valid JSON up to there, with its line."""
    names: list[set[str]] = []
    for token in _TOKEN.finditer(text):
        if token[0] == "{":
            names.append(set())
        elif token[0] == "}":
            names.pop()
        elif token[1] is None:
            return _ambiguous(text, token, f"{token[0]} is not a JSON number; write a number, or null")
        elif token[2] is not None:
            name = json.loads(token[1])
            if name in names[-1]:
                return _ambiguous(text, token, f"'{name}' is given twice in one object; keep one of them")
            names[-1].add(name)
    return _AmbiguousError("a name is given twice in one object; keep one of them")


def _ambiguous(text: str, token: re.Match[str], problem: str) -> _AmbiguousError:
    return _AmbiguousError(f"line {text.count(chr(10), 0, token.start()) + 1}: {problem}")


def plain(value: Any) -> Any:
    """Convert `value` to lists, dicts, strings, numbers, booleans and None."""
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
