"""The constants of registration, read from the source: name, value, and what stands behind them.

A constant is a number, or a tuple of numbers, that a module names in capitals; one in a value that is named
so; or the default of an option.
"""

import ast
import importlib
import pkgutil
import re
from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import dvf_ig.registration as registration

SESSION_MODULES = (
    "ultrasound.beat_evaluation",
    "pose.beat_jobs",
    "pose.confirmation",
    "ultrasound.frame_registration",
    "ultrasound.gated_frames",
    "heart",
    "pose.pose_tracker",
    "pose.registration_jobs",
    "pose.registration_monitor",
)
"""Modules of the session that decide on registrations."""
Number = float | tuple[float, ...]
"""What a constant is."""
_SEED = r"(?:1\d\d|[1-3]\d{3})"
_NAMED_HEARTS = re.compile(
    r"\b(?:(?:tuning|threshold) )?(?:(?:seeds?|hearts?|patients?|pairs?|brains?) )?"
    rf"{_SEED}(?:(?:–|, | and | to ){_SEED})*\b"
)
_NAMES_HEARTS = re.compile(r"^[a-z]")


@dataclass(frozen=True, slots=True)
class Constant:
    """One constant.

    Attributes:
        module: its dotted name.
        name: in the module; `part`: the attribute of a value or the option of a class, empty of a number.
        value: as it stands.
        purpose: the first sentence behind it, or what its class says of it; empty where there is none.
        chosen_on: the seeds, hearts or patients that are named there.
    """

    module: str
    name: str
    part: str
    value: Number
    purpose: str
    chosen_on: str

    @property
    def label(self) -> str:
        """As a reader finds it, for example `lc2.optimise.COARSE.cap_mm`."""
        return f"{self.place}.{self.in_module}"

    @property
    def place(self) -> str:
        """Its module, as short as is clear: `lc2.optimise`."""
        return self.module.removeprefix("dvf_ig.").removeprefix("registration.")

    @property
    def in_module(self) -> str:
        """Its name there: `COARSE.cap_mm`."""
        return f"{self.name}.{self.part}" if self.part else self.name


def registration_constants() -> list[Constant]:
    """Every constant of the registration package and of the session's part in it, by module."""
    names = [module.name for module in pkgutil.walk_packages(registration.__path__, "dvf_ig.registration.")]
    names += [f"dvf_ig.session.{name}" for name in SESSION_MODULES]
    return [constant for name in names for constant in constants_of(importlib.import_module(name))]


def constants_of(module: ModuleType) -> Iterator[Constant]:
    """The constants of one module, in the order of its source."""
    source = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
    for node, after in zip(source.body, [*source.body[1:], None], strict=True):
        if isinstance(node, ast.ClassDef):
            yield from _defaults(module, getattr(module, node.name))
        elif isinstance(node, ast.Assign):
            text = _text(after)
            for name in _capitals(node):
                yield from _parts(module, name, text)


def _capitals(node: ast.Assign) -> Iterator[str]:
    for target in node.targets:
        elements = target.elts if isinstance(target, ast.Tuple) else [target]
        yield from (e.id for e in elements if isinstance(e, ast.Name) and e.id == e.id.upper())


def _parts(module: ModuleType, name: str, text: str) -> Iterator[Constant]:
    value = getattr(module, name)
    if _is_number(value):
        yield Constant(module.__name__, name, "", value, _first(text), _hearts(text))
    elif is_dataclass(value) and not isinstance(value, type):
        explained = _attributes(type(value).__doc__ or "")
        for field in fields(value):
            part = getattr(value, field.name)
            if _is_number(part):
                said = (_first(text).rstrip(".:"), explained.get(field.name, ""))
                purpose = ": ".join(filter(None, said))
                yield Constant(module.__name__, name, field.name, part, purpose, _hearts(text))


def _defaults(module: ModuleType, cls: type) -> Iterator[Constant]:
    if not is_dataclass(cls):
        return
    explained = _attributes(cls.__doc__ or "")
    for field in fields(cls):
        if field.default is not MISSING and _is_number(field.default):
            text = explained.get(field.name) or _first(cls.__doc__ or "")
            yield Constant(
                module.__name__, cls.__name__, field.name, field.default, text, _hearts(cls.__doc__ or "")
            )


def _is_number(value: Any) -> bool:
    if isinstance(value, tuple):
        return bool(value) and all(map(_is_number, value))
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < float("inf")


def _text(node: ast.stmt | None) -> str:
    """The string that follows a constant, as one line."""
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return " ".join(str(node.value.value).split())
    return ""


def _first(text: str) -> str:
    return next(iter(_sentences(text)), "")


def _sentences(text: str) -> list[str]:
    return re.split(r"(?<=[.:])\s+(?=[A-Z])", " ".join(text.split()))


def _hearts(text: str) -> str:
    """The seeds, patients or hearts that are named by number."""
    found = _NAMED_HEARTS.findall(" ".join(text.split()))
    return "; ".join(dict.fromkeys(filter(_NAMES_HEARTS.match, found)))


def _attributes(docstring: str) -> dict[str, str]:
    """Of a docstring's "Attributes:", each name's explanation."""
    explained: dict[str, str] = {}
    for match in re.finditer(r"^\s+([a-z_0-9, ]+): (.+(?:\n\s{12,}.+)*)", docstring, re.MULTILINE):
        for name in match.group(1).split(","):
            explained[name.strip()] = " ".join(match.group(2).split())
    return explained
