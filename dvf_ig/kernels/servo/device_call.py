"""Calls of a haptic device by address: servo loop and watchdog drive every device through two functions.

    int32 read(void *context, int64 now_ns, double *position_mm)       3 numbers, device frame
    int32 write(void *context, int64 now_ns, const double *force_n)    3 numbers, device frame

Both return 0, or a number that is not 0 when the device does not answer. `context` is an int64 array that the
device owns. What a vendor's library wants instead is adapted in C callbacks compiled by numba
(`force_dimension`, `openhaptics`, on the calls of `foreign`).
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
        return builder.call(function, [builder.bitcast(data[0], nothing), args[2], data[1]])

    return types.int32(types.int64, context, types.int64, numbers), build
