"""Encode arrays as text for a page: integers of a step, differences, shuffled bytes, gzip, base64."""

import base64
import gzip
from typing import Any

import numpy as np

from dvf_ig.core import AnyArray, InvalidInputError

TIME_STEP_S = 1e-6
_SIGNED = (np.int8, np.int16, np.int32)


def packed(values: AnyArray, scale: float, *, offset: float = 0.0, delta: bool = False) -> dict[str, Any]:
    """Encode an array as multiples of `scale`, in the smallest integers that hold it.

    Args:
        values: any shape; non-finite values become the least integer of the type.
        scale: the step; multiples of it are kept exactly.
        offset: of the integer 0.
        delta: store differences along the first axis, which are small if values change slowly.
    Raises:
        InvalidInputError: values do not fit into 32 bits.
    """
    finite = np.isfinite(values)
    whole = np.rint((np.where(finite, values, offset) - offset) / scale)
    most = float(np.abs(whole).max(initial=0.0))
    kind = next((kind for kind in _SIGNED if most <= np.iinfo(kind).max), None)
    if kind is None:
        raise InvalidInputError(f"{most * scale:g} in steps of {scale:g} does not fit into 32 bits")
    integers = np.where(finite, whole, np.iinfo(kind).min).astype(kind)
    return _entry(integers, scale=scale, offset=offset, delta=delta)


def packed_times(t_s: AnyArray) -> dict[str, Any]:
    """Encode increasing times from their first whole second on: to 1 µs, or 10 µs beyond half an hour."""
    begin_s = float(np.floor(t_s[0]))
    fits = t_s[-1] - begin_s <= np.iinfo(np.int32).max * TIME_STEP_S
    return packed(t_s, TIME_STEP_S if fits else 10.0 * TIME_STEP_S, offset=begin_s, delta=True)


def packed_exactly(values: AnyArray) -> dict[str, Any]:
    """Encode floating-point numbers as float32, counts as uint32."""
    kind = np.float32 if values.dtype.kind == "f" else np.uint32
    return _entry(values.astype(kind), scale=1.0, offset=0.0, delta=False)


def _entry(values: AnyArray, *, scale: float, offset: float, delta: bool) -> dict[str, Any]:
    stored = np.ascontiguousarray(values)
    if delta and len(stored):
        unsigned = stored.view(np.dtype(f"u{stored.itemsize}"))
        stored = np.concatenate([unsigned[:1], unsigned[1:] - unsigned[:-1]])
    little = stored.astype(stored.dtype.newbyteorder("<"))
    shuffled = np.frombuffer(little.tobytes(), np.uint8).reshape(-1, stored.itemsize).T
    data = gzip.compress(shuffled.tobytes(), compresslevel=6, mtime=0)
    return {
        "dtype": values.dtype.name,
        "shape": list(values.shape),
        "scale": scale,
        "offset": offset,
        "delta": delta,
        "data": base64.b64encode(data).decode("ascii"),
    }
