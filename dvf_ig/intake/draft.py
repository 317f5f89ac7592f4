"""A session's configuration from the options of `dvf-ig config init`, and whether its files can be used."""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvf_ig.core.errors import InvalidInputError
from dvf_ig.io.ecg.trigger import split_ecg
from dvf_ig.io.respiration import split_respiration
from dvf_ig.io.yaml_config import validated

from .findings import Finding
from .fit import fit_of
from .heart_in_images import HeartInImages
from .parts import SessionFiles, missing_parts
from .preop import preop_label_values
from .problems import Problem, ProblemList, Use
from .schema import KEYS, Form, SessionConfig
from .session import examine


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


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """The parts that were read, and every problem that was found.

    Attributes:
        unreadable: files that are absent, damaged, of another kind, or calibrations that were refused.
        misfits: parts that cannot be used, or not together.
        missing: parts that are not named.
        warnings, seen: as of a `Fit`.
    """

    files: SessionFiles
    unreadable: tuple[Problem, ...]
    misfits: tuple[Problem, ...]
    missing: tuple[Problem, ...]
    warnings: tuple[Finding, ...]
    seen: HeartInImages | None

    def hindrances(self, use: Use) -> tuple[Problem, ...]:
        """Problems that prevent a use; a file that cannot be read prevents every use."""
        fit = (problem for problem in (*self.misfits, *self.missing) if problem.concerns(use))
        return (*self.unreadable, *fit)


def judge_session(config: SessionConfig, folder: Path, named_by: str) -> Verdict:
    """Open every file of a configuration and check that all fit.

    Args:
        folder: where names of files begin.
        named_by: what names them, for messages.
    """
    return _verdict(config, *examine(config, folder, named_by))


def begin_session(given: Mapping[str, Any], output: Path) -> tuple[SessionConfig, Verdict]:
    """A configuration of the files that options name, and what is to be said of them.

    Unless the user says otherwise, all labels of an image are taken as inside the protected surface.

    Args:
        given: values of the options of `config init` by their keys (`draft_config`).
        output: the configuration's file; names in it begin at its folder.
    Raises:
        InvalidInputError: options that need another.
    """
    as_given, draft = draft_config(given), draft_config(given, output.parent)
    files, problems = examine(as_given, Path(), str(output))
    if draft.preop is not None and files.preop is not None and not draft.preop.organ_labels:
        all_labels = {"organ_labels": preop_label_values(files.preop.preop)}
        draft = draft.model_copy(update={"preop": draft.preop.model_copy(update=all_labels)})
    return draft, _verdict(as_given, files, problems)


def _verdict(config: SessionConfig, files: SessionFiles, problems: ProblemList) -> Verdict:
    """An ECG that is neither named nor in the ultrasound is missing, not unreadable."""
    absent = tuple(p for p in problems.items if p.key == "ecg" and config.ecg is None)
    fit = fit_of(files)
    wrong = ProblemList([*problems.items, *fit.misfits])
    missing = missing_parts(files, wrong)
    unreadable = tuple(p for p in problems.items if p not in absent)
    return Verdict(files, unreadable, fit.misfits, (*absent, *missing), fit.warnings, fit.seen)
