"""Four doubles side by side in one vector register, as a value that kernels can hold.

A spline sums rows of four coefficients, so its kernel is written on rows. Left to itself the compiler finds
them only with an optimisation that numba switches off for the whole process
(dvf_ig/docs/decisions/0006-force-kernel.md). Every sum keeps the order in which it is written; `plus`
rounds once where the processor can fuse, twice elsewhere.
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


class FourType(types.Type):  # type: ignore[misc]
    """Type of a `Four`; lives inside kernels only, Python never sees one."""

    def __init__(self) -> None:
        super().__init__(name="Four")


Four = Any
"""Four float64 values."""

_FOUR = FourType()


@register_model(FourType)
class _FourModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _ROW)


def _pick(*lanes: int) -> ir.Constant:
    return ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), list(lanes))


def _everywhere(builder: Any, number: Any) -> Any:
    """The same number in all lanes."""
    nothing = ir.Constant(_ROW, ir.Undefined)
    first = builder.insert_element(nothing, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, nothing, _pick(0, 0, 0, 0))


@intrinsic
def four(typing: Any, a: float, b: float, c: float, d: float) -> Four:
    """(a, b, c, d)."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        row = ir.Constant(_ROW, ir.Undefined)
        for lane, number in enumerate(args):
            row = builder.insert_element(row, number, ir.Constant(ir.IntType(32), lane))
        return row

    return _FOUR(*[types.float64] * LANES), build


@intrinsic
def numbers(typing: Any, row: Four) -> Any:
    """The four values, as a tuple of float64."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        lanes = [builder.extract_element(args[0], ir.Constant(ir.IntType(32), k)) for k in range(LANES)]
        return context.make_tuple(builder, signature.return_type, lanes)

    return types.UniTuple(types.float64, LANES)(_FOUR), build


@intrinsic
def row_of(typing: Any, c: Any, p: Any, i: Any, j: Any, k: Any) -> Four:
    """c[p, i, j, k] … c[p, i, j, k+3] of a C-ordered float32 array; indices np.uintp, not checked."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, args[0])
        place = cgutils.get_item_pointer(
            context, builder, signature.args[0], array, args[1:], wraparound=False
        )
        stored = builder.load(builder.bitcast(place, _STORED_ROW.as_pointer()))
        stored.align = np.dtype(np.float32).itemsize
        return builder.fpext(stored, _ROW)

    return _FOUR(c, *[types.uintp] * 4), build


@intrinsic
def scaled(typing: Any, w: float, row: Four) -> Four:
    """w · row."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.fmul(_everywhere(builder, args[0]), args[1])

    return _FOUR(types.float64, _FOUR), build


@intrinsic
def plus(typing: Any, total: Four, w: float, row: Four) -> Four:
    """total + w · row."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        product = builder.fmul(_everywhere(builder, args[1]), args[2], flags=_FUSED)
        return builder.fadd(args[0], product, flags=_FUSED)

    return _FOUR(_FOUR, types.float64, _FOUR), build


@intrinsic
def times(typing: Any, a: Four, b: Four) -> Four:
    """Lane by lane."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.fmul(args[0], args[1])

    return _FOUR(_FOUR, _FOUR), build


@intrinsic
def sums(typing: Any, a: Four, b: Four, c: Four, d: Four) -> Four:
    """(Σa, Σb, Σc, Σd), each as (1st + 2nd) + (3rd + 4th)."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        def added(p: Any, q: Any, one: Any, other: Any) -> Any:
            return builder.fadd(builder.shuffle_vector(p, q, one), builder.shuffle_vector(p, q, other))

        ab, cd = (added(p, q, _pick(0, 2, 4, 6), _pick(1, 3, 5, 7)) for p, q in (args[:2], args[2:]))
        return added(ab, cd, _pick(0, 2, 4, 6), _pick(1, 3, 5, 7))

    return _FOUR(*[_FOUR] * LANES), build
