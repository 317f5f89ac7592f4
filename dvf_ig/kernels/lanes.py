"""Four float64 in one SIMD register, as a value that kernels can hold.

A spline sums rows of four coefficients, LC2 seven products of a pixel: their kernels are written on rows. The
compiler vectorises plain code only with an optimisation that numba switches off for the whole process
(docs/decisions/0006). Every sum keeps the order in which it is written; `fma` rounds once where the processor
has fused multiply-add, twice elsewhere.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import core
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

types: Any = core.types

LANES = 4
_ROW = ir.VectorType(ir.DoubleType(), LANES)
_STORED_ROW = ir.VectorType(ir.FloatType(), LANES)
_FUSED = ("contract",)


class Float64x4Type(types.Type):  # type: ignore[misc]
    """Numba type of a `Float64x4`; exists inside kernels only, never in Python."""

    def __init__(self) -> None:
        super().__init__(name="Float64x4")


Float64x4 = Any
"""Four float64 values."""

_FLOAT64X4 = Float64x4Type()


@register_model(Float64x4Type)
class _Float64x4Model(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _ROW)


def _shuffle_mask(*lanes: int) -> ir.Constant:
    return ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), list(lanes))


def _broadcast(builder: Any, number: Any) -> Any:
    """Broadcast a number to all lanes."""
    undefined = ir.Constant(_ROW, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, undefined, _shuffle_mask(0, 0, 0, 0))


@intrinsic
def pack(typing: Any, a: float, b: float, c: float, d: float) -> Float64x4:
    """Pack four numbers as one row."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        row = ir.Constant(_ROW, ir.Undefined)
        for lane, number in enumerate(args):
            row = builder.insert_element(row, number, ir.Constant(ir.IntType(32), lane))
        return row

    return _FLOAT64X4(*[types.float64] * LANES), build


@intrinsic
def unpack(typing: Any, row: Float64x4) -> Any:
    """Unpack the four values to a tuple of float64."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        lanes = [builder.extract_element(args[0], ir.Constant(ir.IntType(32), k)) for k in range(LANES)]
        return context.make_tuple(builder, signature.return_type, lanes)

    return types.UniTuple(types.float64, LANES)(_FLOAT64X4), build


@intrinsic
def load_row(typing: Any, c: Any, p: Any, i: Any, j: Any, k: Any) -> Float64x4:
    """Load c[p, i, j, k] … c[p, i, j, k+3] of a C-ordered float32 array; indices np.uintp, not checked."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, args[0])
        place = cgutils.get_item_pointer(
            context, builder, signature.args[0], array, args[1:], wraparound=False
        )
        stored = builder.load(builder.bitcast(place, _STORED_ROW.as_pointer()))
        stored.align = np.dtype(np.float32).itemsize
        return builder.fpext(stored, _ROW)

    return _FLOAT64X4(c, *[types.uintp] * 4), build


@intrinsic
def prefetch_row(typing: Any, c: Any, p: Any, i: Any, j: Any, k: Any) -> Any:
    """Prefetch the row that `load_row` will read soon; changes no value."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, args[0])
        place = cgutils.get_item_pointer(
            context, builder, signature.args[0], array, args[1:], wraparound=False
        )
        address, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [address, number, number, number])
        fetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        read, soon, data = (ir.Constant(number, value) for value in (0, 3, 1))
        builder.call(fetch, [builder.bitcast(place, address), read, soon, data])
        return context.get_dummy_value()

    return types.none(c, *[types.uintp] * 4), build


@intrinsic
def scale(typing: Any, w: float, row: Float64x4) -> Float64x4:
    """w · row."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.fmul(_broadcast(builder, args[0]), args[1])

    return _FLOAT64X4(types.float64, _FLOAT64X4), build


@intrinsic
def fma(typing: Any, total: Float64x4, w: float, row: Float64x4) -> Float64x4:
    """Compute total + w · row."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        product = builder.fmul(_broadcast(builder, args[1]), args[2], flags=_FUSED)
        return builder.fadd(args[0], product, flags=_FUSED)

    return _FLOAT64X4(_FLOAT64X4, types.float64, _FLOAT64X4), build


@intrinsic
def multiply(typing: Any, a: Float64x4, b: Float64x4) -> Float64x4:
    """Compute a · b, lane by lane."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.fmul(args[0], args[1])

    return _FLOAT64X4(_FLOAT64X4, _FLOAT64X4), build


@intrinsic
def add(typing: Any, a: Float64x4, b: Float64x4) -> Float64x4:
    """Compute a + b, lane by lane."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.fadd(args[0], args[1])

    return _FLOAT64X4(_FLOAT64X4, _FLOAT64X4), build


@intrinsic
def subtract(typing: Any, a: Float64x4, b: Float64x4) -> Float64x4:
    """Compute a − b, lane by lane."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.fsub(args[0], args[1])

    return _FLOAT64X4(_FLOAT64X4, _FLOAT64X4), build


def _row_place(context: Any, builder: Any, array_type: Any, args: Any) -> Any:
    """Compute the address of a row of an array; args: the array and its indices."""
    array = context.make_array(array_type)(context, builder, args[0])
    place = cgutils.get_item_pointer(context, builder, array_type, array, args[1:], wraparound=False)
    return builder.bitcast(place, _ROW.as_pointer())


@intrinsic
def load4(typing: Any, sums: Any, i: Any, k: Any) -> Float64x4:
    """Load sums[i, k] … sums[i, k+3] of a C-ordered float64 array; indices np.uintp, not checked."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        row = builder.load(_row_place(context, builder, signature.args[0], args))
        row.align = np.dtype(np.float64).itemsize
        return row

    return _FLOAT64X4(sums, types.uintp, types.uintp), build


@intrinsic
def store4(typing: Any, sums: Any, i: Any, k: Any, row: Float64x4) -> Any:
    """Store sums[i, k:k+4] = row; as `load4`."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        stored = builder.store(args[3], _row_place(context, builder, signature.args[0], args[:3]))
        stored.align = np.dtype(np.float64).itemsize
        return context.get_dummy_value()

    return types.none(sums, types.uintp, types.uintp, _FLOAT64X4), build


@intrinsic
def pair_sums(typing: Any, a: Float64x4, b: Float64x4) -> Float64x4:
    """Compute (1st + 3rd, 2nd + 4th) of a, then of b."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        low = builder.shuffle_vector(args[0], args[1], _shuffle_mask(0, 1, 4, 5))
        high = builder.shuffle_vector(args[0], args[1], _shuffle_mask(2, 3, 6, 7))
        return builder.fadd(low, high)

    return _FLOAT64X4(_FLOAT64X4, _FLOAT64X4), build


@intrinsic
def horizontal_sums(typing: Any, a: Float64x4, b: Float64x4, c: Float64x4, d: Float64x4) -> Float64x4:
    """Compute (Σa, Σb, Σc, Σd), each as (1st + 2nd) + (3rd + 4th)."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        def added(p: Any, q: Any, one: Any, other: Any) -> Any:
            return builder.fadd(builder.shuffle_vector(p, q, one), builder.shuffle_vector(p, q, other))

        ab, cd = (
            added(p, q, _shuffle_mask(0, 2, 4, 6), _shuffle_mask(1, 3, 5, 7)) for p, q in (args[:2], args[2:])
        )
        return added(ab, cd, _shuffle_mask(0, 2, 4, 6), _shuffle_mask(1, 3, 5, 7))

    return _FLOAT64X4(*[_FLOAT64X4] * LANES), build
