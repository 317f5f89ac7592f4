"""A constant with another value for the length of a block, wherever it has been imported."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import is_dataclass, replace
from typing import Any

from .listing import Constant, Number


@contextmanager
def varied(constant: Constant, factor: float) -> Iterator[Number]:
    """`constant` is `factor` times as large, whole numbers by one at least but not below 1; yields it."""
    holder = getattr(sys.modules[constant.module], constant.name)
    value = _scaled(constant.value, factor)
    if isinstance(holder, type):
        undo = [_set_default(holder, constant.part, value)]
    else:
        new = replace(holder, **{constant.part: value}) if constant.part else value
        undo = _replace_everywhere(constant.name, holder, new)
    try:
        yield value
    finally:
        for target, name, before in reversed(undo):
            setattr(target, name, before)


def _scaled(value: Number, factor: float) -> Number:
    if isinstance(value, tuple):
        return tuple(_scaled_number(number, factor) for number in value)
    return _scaled_number(value, factor)


def _scaled_number(value: float, factor: float) -> float:
    if isinstance(value, int):
        less, more = min(round(value * factor), value - 1), max(round(value * factor), value + 1)
        return max(min(value, 1), less) if factor < 1 else more
    return value * factor


Undo = tuple[Any, str, Any]
"""Object, attribute, and its value before."""


def _set_default(cls: type, name: str, value: Number) -> Undo:
    """The default of one option of a dataclass."""
    create: Any = vars(cls)["__init__"]
    before = create.__defaults__
    names = create.__code__.co_varnames[1 : create.__code__.co_argcount][-len(before) :]
    create.__defaults__ = tuple(
        value if option == name else old for option, old in zip(names, before, strict=True)
    )
    return create, "__defaults__", before


def _replace_everywhere(name: str, old: Any, new: Any) -> list[Undo]:
    """In every module that holds it under this name, and where it is an option's default."""
    undo: list[Undo] = []
    for module in [m for key, m in sys.modules.items() if key.startswith("dvf_ig.")]:
        if vars(module).get(name) is old:
            undo.append((module, name, old))
            setattr(module, name, new)
        for cls in [c for c in vars(module).values() if isinstance(c, type) and is_dataclass(c)]:
            create: Any = vars(cls)["__init__"]
            defaults = create.__defaults__ or ()
            if any(default is old for default in defaults) and not isinstance(old, int | float):
                undo.append((create, "__defaults__", defaults))
                create.__defaults__ = tuple(new if default is old else default for default in defaults)
    return undo
