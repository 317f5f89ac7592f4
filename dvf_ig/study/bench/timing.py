"""How `dvf-ig bench` times: one call at a time from Python, or many inside a kernel."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray

KERNEL_CALLS = 100
"""Calls inside a kernel between two readings of the clock."""


@dataclass(frozen=True, slots=True)
class Row:
    """One thing timed.

    Attributes:
        name: "dvf_ig", or the library.
        what: what was called.
        median_us, p99_us, p999_us, max_us: a call.
        error_mm: RMS error of |distance| re the exact distance to the mesh; None where nothing is measured.
        calls_per_sample: calls between two readings of the clock; the percentiles are over their means.
        note: what else to know.
    """

    name: str
    what: str
    median_us: float
    p99_us: float
    p999_us: float
    max_us: float
    error_mm: float | None
    calls_per_sample: int
    note: str = ""


def clock_overhead_ns(samples: int = 20_000) -> float:
    """Median time between two readings of the clock with nothing in between."""
    clock = time.perf_counter_ns
    spent = np.empty(samples)
    for n in range(samples):
        start = clock()
        spent[n] = clock() - start
    return float(np.median(spent))


def time_calls(call: Callable[..., Any], arguments: Sequence[tuple[Any, ...]], repeats: int) -> FloatArray:
    """(n,) µs of each call from Python, the fastest of several passes, the clock's own time taken off."""
    clock = time.perf_counter_ns
    overhead = clock_overhead_ns()

    def once() -> FloatArray:
        spent = np.empty(len(arguments))
        for n, given in enumerate(arguments):
            start = clock()
            call(*given)
            spent[n] = clock() - start
        return spent

    call(*arguments[0])
    return np.maximum(_fastest(once, repeats) - overhead, 0.0) / 1e3


def time_batches(batch: Callable[[int, int], Any], count: int, size: int, repeats: int) -> FloatArray:
    """µs a point in each of count / size batches; `batch(begin, end)` does the points of one."""
    clock = time.perf_counter_ns
    begins = range(0, max(count - size, 0) + 1, size)

    def once() -> FloatArray:
        spent = np.empty(len(begins))
        for n, begin in enumerate(begins):
            start = clock()
            batch(begin, begin + size)
            spent[n] = clock() - start
        return spent

    batch(0, size)
    return _fastest(once, repeats) / (size * 1e3)


def row(
    name: str,
    what: str,
    spent_us: FloatArray,
    error_mm: float | None,
    *,
    calls_per_sample: int = 1,
    note: str = "",
) -> Row:
    """The row of a timing."""
    median, p99, p999 = (float(v) for v in np.percentile(spent_us, [50.0, 99.0, 99.9]))
    return Row(name, what, median, p99, p999, float(spent_us.max()), error_mm, calls_per_sample, note)


def _fastest(once: Callable[[], FloatArray], repeats: int) -> FloatArray:
    """The pass with the smallest median: other programs only ever lengthen it."""
    return min((once() for _ in range(repeats)), key=lambda spent: float(np.median(spent)))
