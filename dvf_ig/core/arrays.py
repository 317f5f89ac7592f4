"""Read-only arrays that a value owns: copied once, validated once."""

from collections.abc import Callable
from dataclasses import fields
from functools import wraps
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
    """A read-only float64 copy of `values`.

    Args:
        values: anything numpy can turn into an array.
        name: what the array is called in an error message.
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
    """A read-only copy of `values` with the given dtype and shape (None leaves an axis free)."""
    array = np.array(values, dtype=dtype)
    check_shape(array, name, shape)
    array.setflags(write=False)
    return array


def check_shape(array: AnyArray, name: str, shape: tuple[int | None, ...]) -> None:
    """Raise InvalidInputError unless `array` has `shape` (None leaves an axis free)."""
    fits = array.ndim == len(shape) and all(
        want is None or want == got for want, got in zip(shape, array.shape, strict=True)
    )
    if not fits:
        needed = "(" + ", ".join("n" if want is None else str(want) for want in shape) + ")"
        raise InvalidInputError(f"{name} has shape {array.shape}; needed {needed}")


def read_only_arrays(cls: type[T]) -> type[T]:
    """Class decorator of a frozen dataclass: the arrays that an instance holds cannot be written to.

    A writable array given at construction is copied once, so that its owner cannot change the value either; a
    read-only one is shared. The same holds for arrays in a tuple or a dict, and after unpickling. It stands
    above `@dataclass`.
    """
    names = [f.name for f in fields(cls)]  # type: ignore[arg-type]
    for method in ("__init__", "__setstate__"):
        if hasattr(cls, method):
            setattr(cls, method, _then_protect(getattr(cls, method), names))
    return cls


def _then_protect(method: Callable[..., None], names: list[str]) -> Callable[..., None]:
    @wraps(method)
    def protecting(self: object, *args: Any, **kwargs: Any) -> None:
        method(self, *args, **kwargs)
        for name in names:
            given = getattr(self, name)
            kept = _protected(given)
            if kept is not given:
                object.__setattr__(self, name, kept)

    return protecting


def _protected(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.flags.writeable:
        copy = value.copy(order="K")
        copy.setflags(write=False)
        return copy
    if isinstance(value, tuple) and any(isinstance(v, np.ndarray) for v in value):
        kept = [_protected(v) for v in value]
        return type(value)(*kept) if hasattr(value, "_fields") else tuple(kept)
    if isinstance(value, dict) and any(isinstance(v, np.ndarray) for v in value.values()):
        return {k: _protected(v) for k, v in value.items()}
    return value
