"""A session's configuration from the options of `dvf-ig config init`, as `intake.schema` lists them."""

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dvf_ig.core.errors import InvalidInputError
from dvf_ig.io.ecg.trigger import split_ecg
from dvf_ig.io.respiration import split_respiration
from dvf_ig.io.yaml_config import validated

from .schema import KEYS, Form, SessionConfig


def draft_config(given: Mapping[str, Any], folder: Path | None = None) -> SessionConfig:
    """The configuration that options state, in which any part may be missing.

    Args:
        given: values of options by the keys that they set, as words; None if an option was not given.
        folder: where names of files are to begin; None leaves them as the user gave them.
    Raises:
        InvalidInputError: an option that needs another one, or words that are not of its form.
    """
    there = {key: value for key, value in given.items() if value not in (None, ())}
    document: dict[str, Any] = {}
    for name, value in there.items():
        _require_company(name, there)
        section, _, entry = name.rpartition(".")
        inside = document.setdefault(section, {}) if section else document
        inside |= _entries(entry, KEYS[name].form, value, folder, KEYS[name].options[0])
    if "name" in document.get("tool", {}) and "file" not in document["tool"]:
        document["tool"]["file"] = document.get("ultrasound", {}).get("file")
    return validated(SessionConfig, document, Path("options"))


def _require_company(name: str, there: Mapping[str, Any]) -> None:
    """Refuse an option that says something of another one's file if that is not given."""
    key, section = KEYS[name], name.rpartition(".")[0]
    needed = [f"{section}.{other}" for other in key.goes_with]
    if needed and not any(other in there for other in needed):
        options = " or ".join(" ".join(KEYS[other].option.split()[:2]) for other in needed)
        raise InvalidInputError(f"{key.options[0]} needs another option; also give {options}")


def _entries(entry: str, form: Form, value: Any, folder: Path | None, option: str) -> dict[str, Any]:
    """Convert an option's words to keys of its section."""
    match form:
        case Form.FILE:
            return {entry: _relative(value, folder)}
        case Form.ECG:
            parts = split_ecg(value)
            return {entry: f"{parts.prefix}{_relative(parts.name, folder)}{parts.field}"}
        case Form.BREATH:
            breath = split_respiration(value)
            return {entry: f"{breath.prefix}{_relative(breath.name, folder)}{breath.field}"}
        case Form.SOURCE:
            seconds = _number(value)
            return {entry: _relative(value, folder) if seconds is None else seconds}
        case Form.PAIR:
            marked, touched = value
            other = entry.replace("_mr", "_tracker")
            return {entry: _relative(marked, folder), other: _relative(touched, folder)}
        case Form.POINTS:
            return _points(entry, value, folder, option)
        case Form.VOLUMES:
            return {entry: [_volume(text, folder) for text in value]}
        case Form.WHOLES:
            return {entry: _numbers(value, int, option, "whole numbers such as 1,2,5")}
        case Form.FAN:
            needed = "five numbers: column and row of the apex, first and last radius (px), half angle (rad)"
            numbers = _numbers(value, float, option, needed)
            if len(numbers) != 5:
                raise InvalidInputError(f"{option} is '{value}'; needed {needed}")
            return {
                entry: {
                    "apex_px": numbers[:2],
                    "start_px": numbers[2],
                    "stop_px": numbers[3],
                    "half_angle_rad": numbers[4],
                }
            }
    return {entry: value}


def _points(entry: str, text: str, folder: Path | None, option: str) -> dict[str, Any]:
    """POINTS or POINTS@PHASE; an @ may also be part of a file's name."""
    file, at, phase = text.rpartition("@")
    if not at or Path(text).is_file():
        return {entry: _relative(text, folder)}
    fraction = _number(phase)
    if not file or fraction is None or not 0.0 <= fraction < 1.0:
        raise InvalidInputError(
            f"{option} is '{text}'; needed POINTS@PHASE, a file and a fraction of the cycle from 0 to below 1"
        )
    return {entry: _relative(file, folder), f"{entry}_phase": fraction}


def _volume(text: str, folder: Path | None) -> str:
    """FILE@PHASE or FILE=SECONDS; other text is refused by the schema."""
    cut = max(text.rfind("@"), text.rfind("="))
    return text if cut < 1 else f"{_relative(text[:cut], folder)}{text[cut:]}"


def _numbers(text: str, kind: type[int] | type[float], option: str, needed: str) -> list[float]:
    try:
        return [kind(part) for part in text.split(",")]
    except ValueError as exc:
        raise InvalidInputError(f"{option} is '{text}'; needed {needed}") from exc


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _relative(name: str | Path, folder: Path | None) -> str:
    """A file's name from a folder, with / between its parts on every system."""
    if folder is None or not str(name):
        return str(name)
    return Path(os.path.relpath(Path(name).absolute(), folder.absolute())).as_posix()
