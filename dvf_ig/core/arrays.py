"""Read-only arrays that a value owns: copied once, validated once."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import wraps
from types import NoneType, UnionType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .errors import InvalidInputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
AnyArray = NDArray[Any]
T = TypeVar("T")


def frozen_floats(
    values: Any, name: str, shape: tuple[int | None, ...], *, finite: bool = True
) -> FloatArray:
    """Copy `values` to a read-only float64 array.

    Args:
        values: anything that numpy can convert to an array.
        name: name of the array in an error message.
        shape: needed shape; None leaves an axis free.
        finite: refuse NaN and infinity.
    Raises:
        InvalidInputError: wrong shape, or a non-finite entry.
    """
    array = np.array(values, dtype=np.float64)
    check_shape(array, name, shape)
    if finite and not np.isfinite(array).all():
        bad = int(np.count_nonzero(~np.isfinite(array)))
        raise InvalidInputError(f"{name} has {bad} non-finite values; every entry must be a finite number")
    array.setflags(write=False)
    return array


def frozen(values: Any, name: str, shape: tuple[int | None, ...], dtype: Any) -> AnyArray:
    """Copy `values` to a read-only array of the given dtype and shape (None leaves an axis free)."""
    array = np.array(values, dtype=dtype)
    check_shape(array, name, shape)
    array.setflags(write=False)
    return array


def check_shape(array: AnyArray, name: str, shape: tuple[int | None, ...]) -> None:
    """Raise InvalidInputError unless `array` has `shape` (None leaves an axis free)."""
    fits = array.shape == shape or (
        array.ndim == len(shape)
        and all(want is None or want == got for want, got in zip(shape, array.shape, strict=True))
    )
    if not fits:
        needed = "(" + ", ".join("n" if want is None else str(want) for want in shape) + ")"
        raise InvalidInputError(f"{name} has shape {array.shape}; needed {needed}")


def read_only_arrays(cls: type[T]) -> type[T]:
    """Decorate a frozen dataclass so that the arrays of its instances cannot be written to.

    An array that anybody could still write to is copied once at construction; others are shared. The same
    holds for arrays within tuples and dicts, and after unpickling. Place it above `@dataclass`.
    """
    names = [f.name for f in fields(cls) if not _holds_no_array(f.type)]  # type: ignore[arg-type]
    restore = getattr(cls, "__setstate__", _restored)
    for method, original in (("__init__", cls.__init__), ("__setstate__", restore)):
        setattr(cls, method, _then_protect(original, names))
    return cls


def _restored(self: object, state: dict[str, Any]) -> None:
    """Restore the state of an unpickled instance without slots."""
    for name, value in state.items():
        object.__setattr__(self, name, value)


def _then_protect(method: Callable[..., None], names: list[str]) -> Callable[..., None]:
    @wraps(method)
    def protecting(self: object, *args: Any, **kwargs: Any) -> None:
        method(self, *args, **kwargs)
        for name in names:
            value = getattr(self, name)
            if not isinstance(value, _HOLDERS):
                continue
            protected = _protected(value)
            if protected is not value:
                object.__setattr__(self, name, protected)

    return protecting


_HOLDERS = (np.ndarray, tuple, dict)


def _holds_no_array(kind: Any) -> bool:
    """Return whether values of a type need no look: numbers, texts, enumerations, dataclasses, None."""
    if isinstance(kind, UnionType):
        return all(map(_holds_no_array, kind.__args__))
    numbers = (int, float, str, Enum, NoneType)
    return isinstance(kind, type) and (issubclass(kind, numbers) or is_dataclass(kind))


def _protected(value: Any) -> Any:
    """Return the value itself if nothing in it can be written to, else one that owns its arrays."""
    if isinstance(value, np.ndarray):
        if not _writable(value):
            return value
        copy = value.copy(order="K")
        copy.setflags(write=False)
        return copy
    if isinstance(value, tuple):
        parts = [_protected(v) for v in value]
        if all(k is v for k, v in zip(parts, value, strict=True)):
            return value
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    if isinstance(value, dict):
        items = {k: _protected(v) for k, v in value.items()}
        return value if all(items[k] is v for k, v in value.items()) else items
    return value


def _writable(array: AnyArray) -> bool:
    """Return whether the array, or one that it is a view of, can be written to."""
    seen: object = array
    while isinstance(seen, np.ndarray):
        if seen.flags.writeable:
            return True
        seen = seen.base
    return False
