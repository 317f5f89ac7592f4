"""Read-only arrays that a value owns: copied once, validated once."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import InvalidInputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
AnyArray = NDArray[Any]


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
