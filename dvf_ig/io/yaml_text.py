"""Parse YAML that has exactly one meaning: repeated keys and ambiguous values are refused.

Numbers are decimal: `2`, `-0.5`, `+2`, `1.`, `.5`, `1e3`. `true`, `false` and `null` (`~`, nothing) have
their usual meaning; every other plain word is text, including `off`, `yes` and `2020-01-31`. Refused: a
repeated key; `010`, `0x10`, `0b1`, `1_0`, `1:30`, which YAML 1.1 and 1.2 read as different numbers; `.inf`,
`.nan`; anchors, aliases, merge keys, tags; a second document. Keys are texts; a whole number may be one
(labels).
"""

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from dvf_ig.core.errors import UnreadableFileError

from .limits import NESTING

_WHOLE = re.compile(r"[-+]?(0|[1-9][0-9]*)")
_DECIMAL = re.compile(r"[-+]?((0|[1-9][0-9]*)(\.[0-9]*)?|\.[0-9]+)(e[-+]?[0-9]+)?", re.IGNORECASE)
_NOT_FINITE = re.compile(r"[-+]?\.?(inf|infinity|nan)", re.IGNORECASE)
_OTHER_NUMBER = re.compile(
    r"[-+]?(0x[0-9a-f_]+|0o[0-7_]+|0b[01_]+|(?=\.?[0-9])[0-9_]*(:[0-9]+)*\.?[0-9_]*(e[-+]?[0-9_]+)?)",
    re.IGNORECASE,
)
"""Octal, hexadecimal, binary, sexagesimal, with underscores or leading zeros: a number to some programs."""
_LONGEST_WHOLE = 19
"""Most characters of a whole number: 64 bits."""
_WORDS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}


class _NotPlainError(ValueError):
    """Plain scalar that programs read differently; the message states what to write instead."""


def parse_yaml(text: str, path: Path, what: str) -> Any:
    """Parse the only document of a text.

    Args:
        text: YAML.
        path: the file, for messages.
        what: what it should be, with its article, for example "a scenario description".
    Raises:
        UnreadableFileError: not YAML, or ambiguous; names file, line and key.
    """
    try:
        return _Document(text, path).read()
    except yaml.MarkedYAMLError as exc:
        line = "" if exc.problem_mark is None else f"line {exc.problem_mark.line + 1}: "
        problem = exc.problem or exc.context or ""
        if "escape character" in problem:
            problem += "; in double quotes \\ begins an escape: write / instead"
        raise UnreadableFileError(f"{path} is not YAML: {line}{problem}") from exc
    except yaml.YAMLError as exc:
        raise UnreadableFileError(f"{path} is not YAML: {' '.join(str(exc).split())[:400]}") from exc
    except UnreadableFileError:
        raise
    except (ValueError, OverflowError) as exc:  # an escape beyond Unicode
        raise UnreadableFileError(f"{path} is not {what}: a character that does not exist ({exc})") from exc


def yaml_text(document: Any, *, flow: bool | None = False, width: int = 80) -> str:
    """Format a document as YAML that `parse_yaml` reads back to an equal value.

    Args:
        document: lists, dicts, texts, finite numbers, booleans and None.
        flow: True writes brackets; None only for lists and dicts that hold no others.
        width: longest line before it is folded.
    """
    return yaml.dump(
        document, Dumper=_Dumper, sort_keys=False, allow_unicode=True, default_flow_style=flow, width=width
    )


class _Dumper(yaml.SafeDumper):
    """Dumper without aliases that quotes each text that would be read as something else."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_text(self, value: str) -> yaml.ScalarNode:
        plain = not (
            _DECIMAL.fullmatch(value) or _NOT_FINITE.fullmatch(value) or _OTHER_NUMBER.fullmatch(value)
        )
        return self.represent_scalar("tag:yaml.org,2002:str", value, style=None if plain else "'")


_Dumper.add_representer(str, _Dumper.represent_text)


class _Document:
    """Document of a stream of events."""

    def __init__(self, text: str, path: Path) -> None:
        self._events: Iterator[yaml.Event] = yaml.parse(text, Loader=yaml.SafeLoader)
        self._path = path

    def read(self) -> Any:
        next(self._events)  # the stream's start
        if isinstance(next(self._events), yaml.StreamEndEvent):
            return None
        value = self._value(next(self._events), ())
        next(self._events)  # the document's end
        after = next(self._events)
        if not isinstance(after, yaml.StreamEndEvent):
            raise self._error(after, (), "a second document begins; a file holds one: remove this '---'")
        return value

    def _value(self, event: yaml.Event, key: tuple[str, ...]) -> Any:
        if len(key) > NESTING:
            raise self._error(event, key[:3], f"nested more than {NESTING} deep; needed fewer levels")
        if isinstance(event, yaml.AliasEvent):
            raise self._error(
                event, key, f"the alias '*{event.anchor}' is not supported; write its value out"
            )
        if isinstance(event, yaml.NodeEvent) and event.anchor is not None:
            raise self._error(event, key, f"the anchor '&{event.anchor}' is not supported; remove it")
        if isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent) and event.tag is not None:
            tag = event.tag.replace("tag:yaml.org,2002:", "!!")
            raise self._error(event, key, f"the tag '{tag}' is not supported; write the value alone")
        if isinstance(event, yaml.ScalarEvent):
            return self._scalar(event, key)
        return self._list(key) if isinstance(event, yaml.SequenceStartEvent) else self._mapping(key)

    def _scalar(self, event: yaml.ScalarEvent, key: tuple[str, ...]) -> Any:
        if event.style is not None:
            return event.value
        try:
            return _plain(event.value)
        except _NotPlainError as exc:
            raise self._error(event, key, str(exc)) from exc

    def _list(self, key: tuple[str, ...]) -> list[Any]:
        values: list[Any] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            values.append(self._value(event, (*key, str(len(values)))))
        return values

    def _mapping(self, key: tuple[str, ...]) -> dict[str, Any]:
        values: dict[str, Any] = {}
        lines: dict[str, int] = {}
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            name = self._name(event, key)
            if name in values:
                first = lines[name]
                raise self._error(
                    event, key, f"'{name}' is given twice, first in line {first}; keep one of them"
                )
            lines[name] = _line(event)
            values[name] = self._value(next(self._events), (*key, name))
        return values

    def _name(self, event: yaml.Event, key: tuple[str, ...]) -> str:
        """Parse a key of a mapping."""
        if not isinstance(event, yaml.ScalarEvent):
            if isinstance(event, yaml.AliasEvent):
                self._value(event, key)
            raise self._error(event, key, "a list or a mapping is not a key; write a word and a colon")
        if event.value == "<<":
            raise self._error(event, key, "the merge key '<<' is not supported; write the keys out")
        value = self._value(event, key)
        if isinstance(value, str) or (type(value) is int and str(value) == event.value):
            return str(event.value)
        raise self._error(event, key, f"'{event.value}' is not a key; write a word, or put it in quotes")

    def _error(self, event: yaml.Event, key: tuple[str, ...], problem: str) -> UnreadableFileError:
        where = ", ".join([f"line {_line(event)}", *([".".join(key)] if key else [])])
        return UnreadableFileError(f"{self._path}: {where}: {problem}")


def _line(event: yaml.Event) -> int:
    return 0 if event.start_mark is None else event.start_mark.line + 1


def _plain(text: str) -> Any:
    """Return the value of a scalar without quotes."""
    if text in _WORDS:
        return _WORDS[text]
    if _NOT_FINITE.fullmatch(text):
        raise _NotPlainError(f"{text} is not a finite number; write a decimal number, or a text in quotes")
    if _DECIMAL.fullmatch(text):
        return _number(text)
    if _OTHER_NUMBER.fullmatch(text):
        raise _NotPlainError(
            f"{text} is read differently by different programs; write a decimal number, such as 10 or 0.5, "
            f"or a text in quotes: '{text}'"
        )
    return text


def _number(text: str) -> int | float:
    if _WHOLE.fullmatch(text) and len(text) <= _LONGEST_WHOLE:
        return int(text)
    value = float(text)
    rounded_to_zero = value == 0.0 and re.split("[eE]", text)[0].strip("+-.0") != ""
    if _WHOLE.fullmatch(text) or rounded_to_zero or not math.isfinite(value):
        raise _NotPlainError(
            f"{text[:24]} is more than a number can hold; write a smaller one, or a text in quotes"
        )
    return value
