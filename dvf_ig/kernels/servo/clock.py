"""The machine's clocks and an absolute sleep, for kernels: POSIX calls without Python (Linux).

`clock_nanosleep` with an absolute time does not add up the errors of many relative sleeps, and does not spin.
"""

from typing import Any

from llvmlite import ir
from numba import core
from numba.extending import intrinsic

from dvf_ig.kernels.compiled import kernel

types: Any = core.types

CLOCK_MONOTONIC = 1
CLOCK_BOOTTIME = 7
ABSOLUTE = 1
NS_PER_S = 1_000_000_000

_ADDRESS = types.CPointer(types.int64)
_clock_gettime = types.ExternalFunction("clock_gettime", types.int32(types.int32, _ADDRESS))
_clock_nanosleep = types.ExternalFunction(
    "clock_nanosleep", types.int32(types.int32, types.int32, _ADDRESS, _ADDRESS)
)
_prctl = types.ExternalFunction(
    "prctl", types.int32(types.int32, types.uint64, types.uint64, types.uint64, types.uint64)
)
_SET_TIMER_SLACK = 29


@intrinsic
def address_of(typing: Any, array: Any) -> Any:
    """Address of an int64 array's first number, for C functions."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return context.make_array(signature.args[0])(context, builder, args[0]).data

    return _ADDRESS(array), build


@intrinsic
def null_address(typing: Any) -> Any:
    """NULL."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return ir.Constant(context.get_value_type(signature.return_type), None)

    return _ADDRESS(), build


@kernel
def _clock_ns(clock: int, timespec: Any) -> int:
    _clock_gettime(clock, address_of(timespec))
    nanoseconds: int = timespec[0] * NS_PER_S + timespec[1]
    return nanoseconds


@kernel
def monotonic_ns(timespec: Any) -> int:
    """Nanoseconds of CLOCK_MONOTONIC, that of Python's `time.monotonic_ns`.

    Args:
        timespec: (2,) int64 of this thread.
    """
    return _clock_ns(CLOCK_MONOTONIC, timespec)


@kernel
def elapsed_ns(timespec: Any) -> int:
    """Nanoseconds of CLOCK_BOOTTIME, which also runs while the machine is suspended.

    Args:
        timespec: (2,) int64 of this thread.
    """
    return _clock_ns(CLOCK_BOOTTIME, timespec)


@kernel
def sleep_until(t_ns: int, timespec: Any) -> int:
    """Sleep until a time of `monotonic_ns` (again after a signal); the time of waking."""
    while True:
        timespec[0] = t_ns // NS_PER_S
        timespec[1] = t_ns - timespec[0] * NS_PER_S
        _clock_nanosleep(CLOCK_MONOTONIC, ABSOLUTE, address_of(timespec), null_address())
        now = monotonic_ns(timespec)
        if now >= t_ns:
            return now


@kernel
def wake_exactly() -> None:
    """Ask Linux not to add its usual 50 µs to this thread's sleeps (no effect on real-time threads)."""
    _prctl(_SET_TIMER_SLACK, 1, 0, 0, 0)
