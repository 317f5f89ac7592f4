"""Calls of haptic devices by address: ours through two functions, and those of vendors' libraries.

    int32 read(void *context, int64 now_ns, double *position_mm)       3 numbers, device frame
    int32 write(void *context, int64 now_ns, const double *force_n)    3 numbers, device frame

Both return 0, or a number that is not 0 when the device does not answer. `context` is an int64 array that the
device owns. What a vendor's library wants instead is adapted in C callbacks compiled by numba
(`force_dimension`, `openhaptics`).
Source: dhdc.h of the Force Dimension SDK; hd.h and hdDefines.h of OpenHaptics.
"""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import core
from numba.extending import intrinsic

from dvf_ig.kernels.compiled import callback

types: Any = core.types

SIGNATURE = types.int32(types.voidptr, types.int64, types.CPointer(types.float64))

_INT64 = ir.IntType(64)
_FUNCTION = ir.FunctionType(
    ir.IntType(32), [ir.IntType(8).as_pointer(), _INT64, ir.DoubleType().as_pointer()]
).as_pointer()


def device_function(function: Callable[..., int]) -> Any:
    """A function of the kind above, as a C callback; its `address` is what the loop calls."""
    return callback(SIGNATURE)(function)


@intrinsic
def call_device(typing: Any, address: int, context: Any, now_ns: int, numbers: Any) -> Any:
    """The function at `address` with a device's context, a time and three numbers."""

    def build(context_: Any, builder: Any, signature: Any, args: Any) -> Any:
        function = builder.inttoptr(args[0], _FUNCTION)
        data = [context_.make_array(signature.args[k])(context_, builder, args[k]).data for k in (1, 3)]
        nothing = ir.IntType(8).as_pointer()
        answer = builder.call(function, [builder.bitcast(data[0], nothing), args[2], data[1]])
        return builder.sext(answer, _INT64)

    return types.int64(types.int64, context, types.int64, numbers), build


_INT8, _INT32, _INT64 = ir.IntType(8), ir.IntType(32), ir.IntType(64)
_DOUBLE = ir.DoubleType()
_NUMBERS = _DOUBLE.as_pointer()


def _function(builder: Any, address: Any, result: Any, *arguments: Any) -> Any:
    return builder.inttoptr(address, ir.FunctionType(result, arguments).as_pointer())


def _numbers_at(context: Any, builder: Any, kind: Any, array: Any, i: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.gep(data, [i])


@intrinsic
def call_get_position(typing: Any, address: int, out: Any, i: int, device: int) -> Any:
    """int dhdGetPosition(double *x, double *y, double *z, char id), into out[i], out[i+1], out[i+2]."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        function = _function(builder, args[0], _INT32, _NUMBERS, _NUMBERS, _NUMBERS, _INT8)
        first = _numbers_at(context, builder, signature.args[1], args[1], args[2])
        places = [builder.gep(first, [ir.Constant(_INT64, k)]) for k in range(3)]
        return builder.call(function, [*places, builder.trunc(args[3], _INT8)])

    return types.int32(types.int64, out, types.int64, types.int64), build


@intrinsic
def call_set_force(typing: Any, address: int, x: float, y: float, z: float, device: int) -> Any:
    """int dhdSetForce(double fx, double fy, double fz, char id)."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        function = _function(builder, args[0], _INT32, _DOUBLE, _DOUBLE, _DOUBLE, _INT8)
        return builder.call(function, [*args[1:4], builder.trunc(args[4], _INT8)])

    number = types.float64
    return types.int32(types.int64, number, number, number, types.int64), build


@intrinsic
def call_get_button(typing: Any, address: int, device: int) -> Any:
    """int dhdGetButton(int index, char id) of the first button: 1 while it is pressed."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        function = _function(builder, args[0], _INT32, _INT32, _INT8)
        return builder.call(function, [ir.Constant(_INT32, 0), builder.trunc(args[1], _INT8)])

    return types.int32(types.int64, types.int64), build


@intrinsic
def call_with_handle(typing: Any, address: int, handle: int) -> Any:
    """void hdBeginFrame(HHD), void hdEndFrame(HHD), void hdMakeCurrentDevice(HHD)."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.call(_function(builder, args[0], ir.VoidType(), _INT32), [builder.trunc(args[1], _INT32)])
        return context.get_dummy_value()

    return types.none(types.int64, types.int64), build


@intrinsic
def call_doubles(typing: Any, address: int, name: int, numbers: Any, i: int) -> Any:
    """void hdGetDoublev(HDenum, HDdouble *), void hdSetDoublev(HDenum, const HDdouble *), at numbers[i]."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        function = _function(builder, args[0], ir.VoidType(), _INT32, _NUMBERS)
        first = _numbers_at(context, builder, signature.args[2], args[2], args[3])
        builder.call(function, [builder.trunc(args[1], _INT32), first])
        return context.get_dummy_value()

    return types.none(types.int64, types.int64, numbers, types.int64), build


@intrinsic
def call_integers(typing: Any, address: int, name: int, numbers: Any, i: int) -> Any:
    """void hdGetIntegerv(HDenum, HDint *), into the lower half of the int64 numbers[i]."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        function = _function(builder, args[0], ir.VoidType(), _INT32, _INT32.as_pointer())
        place = _numbers_at(context, builder, signature.args[2], args[2], args[3])
        builder.call(function, [builder.trunc(args[1], _INT32), builder.bitcast(place, _INT32.as_pointer())])
        return context.get_dummy_value()

    return types.none(types.int64, types.int64, numbers, types.int64), build


@intrinsic
def call_error_code(typing: Any, address: int) -> Any:
    """HDErrorInfo hdGetError(void): three 32-bit numbers in two registers, of which the first is the code."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        packed = builder.call(_function(builder, args[0], _INT64), [])
        return builder.and_(packed, ir.Constant(_INT64, 0xFFFFFFFF))

    return types.int64(types.int64), build
