"""Memory shared between threads without locks: atomic numbers, and a sequence lock around an array.

A sequence lock has one writer and any number of readers. A writer never waits, and a reader reads again when
a write came between. Why no torn value can pass (C11 memory model, as Boehm 2012, "Can seqlocks get along
with programming language memory models?"):

- every access to the array and to the counter is atomic, so no access is a data race, whatever the compiler
  or the processor reorders;
- the writer makes the counter odd, then a release fence: if a reader sees any of the new numbers, its acquire
  fence orders its second look at the counter after that odd count, so it sees a changed counter;
- the writer's last store of the counter is a release, the reader's first look an acquire: a reader that
  starts from an even count sees all numbers stored before it.

The numbers are loaded and stored "monotonic" (relaxed), which on x86 and ARM are plain moves.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import core
from numba.extending import intrinsic

from dvf_ig.kernels.compiled import kernel

types: Any = core.types

TRIES = 64
"""A reader gives up after so many torn reads and keeps what it has; one write takes less than a µs."""
_BYTES = 8


def _place(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    array = context.make_array(signature.args[0])(context, builder, args[0])
    return builder.gep(array.data, [args[1]])


def _kind(array: Any) -> Any:
    return ir.IntType(64) if array.dtype == types.int64 else ir.DoubleType()


def _load(ordering: str) -> Any:
    def declared(typing: Any, array: Any, i: Any) -> Any:
        def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = _kind(signature.args[0])
            return builder.load_atomic(_place(context, builder, signature, args), ordering, _BYTES, typ=kind)

        return array.dtype(array, types.intp), build

    return declared


def _store(ordering: str) -> Any:
    def declared(typing: Any, array: Any, i: Any, value: Any) -> Any:
        def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            builder.store_atomic(args[2], _place(context, builder, signature, args[:2]), ordering, _BYTES)
            return context.get_dummy_value()

        return types.none(array, types.intp, array.dtype), build

    return declared


@intrinsic
def load_acquire(typing: Any, array: Any, i: int) -> Any:
    """array[i] (int64 or float64); what follows is not moved before it."""
    return _load("acquire")(typing, array, i)


@intrinsic
def load_relaxed(typing: Any, array: Any, i: int) -> Any:
    """array[i], atomic, without an order."""
    return _load("monotonic")(typing, array, i)


@intrinsic
def store_release(typing: Any, array: Any, i: int, value: Any) -> Any:
    """array[i] = value; what precedes is not moved after it."""
    return _store("release")(typing, array, i, value)


@intrinsic
def store_relaxed(typing: Any, array: Any, i: int, value: Any) -> Any:
    """array[i] = value, atomic, without an order."""
    return _store("monotonic")(typing, array, i, value)


@intrinsic
def store_ordered(typing: Any, array: Any, i: int, value: Any) -> Any:
    """array[i] = value, in one order with all ordered loads and stores of all threads."""
    return _store("seq_cst")(typing, array, i, value)


@intrinsic
def load_ordered(typing: Any, array: Any, i: int) -> Any:
    """array[i], in one order with all ordered loads and stores of all threads."""
    return _load("seq_cst")(typing, array, i)


@intrinsic
def fence_acquire(typing: Any) -> Any:
    """Loads before it are not moved after loads and stores that follow."""
    return types.none(), _fence("acquire")


@intrinsic
def fence_release(typing: Any) -> Any:
    """Loads and stores before it are not moved after stores that follow."""
    return types.none(), _fence("release")


def _fence(ordering: str) -> Any:
    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.fence(ordering)
        return context.get_dummy_value()

    return build


@kernel
def publish(counter: Any, shared: Any, values: Any) -> None:
    """Write `values` into the shared array; from one thread at a time.

    Args:
        counter: (n,) int64, of which the first is the lock's count.
        shared: (m,) of a type of 8 bytes; values: of the same, its first numbers, or all of them.
    """
    count = load_relaxed(counter, 0)
    store_relaxed(counter, 0, count + 1)
    fence_release()
    for i in range(len(values)):
        store_relaxed(shared, i, values[i])
    store_release(counter, 0, count + 2)


@kernel
def read_shared(counter: Any, shared: Any, seen: int, out: Any, work: Any, head: int, number: int) -> int:
    """Read the shared array into `out`; `out` stays as it is where nothing is new or every read was torn.

    Args:
        counter, shared: as in `publish`.
        seen: count of the last read, or −1.
        out, work: (m,) of the reader.
        head: of the numbers, those that change with every publication; the others are read where that at
            `number`, in the head, differs from the one in `out`.
    Returns:
        the count that was read.
    """
    for _ in range(TRIES):
        count = load_acquire(counter, 0)
        if count == seen:
            return seen
        if count & 1:
            continue
        for i in range(head):
            work[i] = load_relaxed(shared, i)
        changed = head if work[number] == out[number] else len(shared)
        for i in range(head, changed):
            work[i] = load_relaxed(shared, i)
        fence_acquire()
        if load_relaxed(counter, 0) == count:
            for i in range(changed):
                out[i] = work[i]
            read: int = count
            return read
    return seen


@kernel
def load_number(numbers: Any, i: int) -> int:
    """numbers[i] with everything that was stored before it."""
    value: int = load_acquire(numbers, i)
    return value


@kernel
def store_number(numbers: Any, i: int, value: int) -> None:
    """numbers[i] = value, after everything that was stored before."""
    store_ordered(numbers, i, value)


def new_counter() -> Any:
    """The count of a sequence lock, alone in its cache line."""
    return np.zeros(16, dtype=np.int64)
