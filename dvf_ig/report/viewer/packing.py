"""Arrays as text for a page: whole numbers of a step, differences, bytes shuffled, gzip, base64."""

from __future__ import annotations

import base64
import gzip
from typing import Any

import numpy as np

from dvf_ig.core.arrays import AnyArray
from dvf_ig.core.errors import InvalidInputError

TIME_STEP_S = 1e-6
_SIGNED = (np.int8, np.int16, np.int32)


def packed(values: AnyArray, scale: float, *, offset: float = 0.0, delta: bool = False) -> dict[str, Any]:
    """An array in whole numbers of `scale`, in the smallest integers that hold it.

    Args:
        values: any shape; what is not finite becomes the least integer of the type.
        scale: the step; a value that is printed with so many decimals is kept exactly.
        offset: of the integer 0.
        delta: store differences along the first axis, which are small where values change slowly.
    Raises:
        InvalidInputError: values that 32 bits do not hold.
    """
    known = np.isfinite(values)
    whole = np.rint((np.where(known, values, offset) - offset) / scale)
    most = float(np.abs(whole).max(initial=0.0))
    kind = next((kind for kind in _SIGNED if most <= np.iinfo(kind).max), None)
    if kind is None:
        raise InvalidInputError(f"{most * scale:g} in steps of {scale:g} does not fit into 32 bits")
    integers = np.where(known, whole, np.iinfo(kind).min).astype(kind)
    return _entry(integers, scale=scale, offset=offset, delta=delta)


def packed_times(t_s: AnyArray) -> dict[str, Any]:
    """Times in order, from the second in which the first lies: to 1 µs, or to 10 µs beyond half an hour."""
    begin_s = float(np.floor(t_s[0]))
    fits = t_s[-1] - begin_s <= np.iinfo(np.int32).max * TIME_STEP_S
    return packed(t_s, TIME_STEP_S if fits else 10.0 * TIME_STEP_S, offset=begin_s, delta=True)


def packed_exactly(values: AnyArray) -> dict[str, Any]:
    """Floating-point numbers as float32, counts as uint32."""
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
