"""The servo loop, in real or simulated time; the watchdog; the machine's floor."""

from typing import Any

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.kernels.compiled import kernel

from .borrowed import borrowed
from .clock import monotonic_ns, sleep_until, wake_exactly
from .device_call import call_device
from .record import LATENESS_NS, ROW, TICK, WORK_NS
from .shared import (
    fence_acquire,
    load_ordered,
    load_relaxed,
    read_shared,
    store_ordered,
    store_relaxed,
    store_release,
)
from .supervision import rearm
from .tick import MISSED_DEADLINES, SUPERVISION, TOOL, unpacked_tick

# Places in the shared numbers: each alone in its cache line.
STOP = 0
HEARTBEAT_NS = 8
TRIPPED = 16
REARM_ASKED = 24
REARM_ANSWERED = 32
REARM_ANSWER = 40
HEAD = 48
SKIPPED = 56
WORST_NS = 64
LATE_NS = 72
"""Set before the start: what counts as late."""
WATCHDOG_NS = 80
"""Set before a start in simulated time: how long the watchdog waits; 0 without one."""
NUMBERS = 88

LATE_TICKS = 3
LATE_WITHIN = 100
"""So many ticks that woke late, or came after one that ended late, within so many: no force, latched."""
SETTLE_NS = 20_000_000
"""The first tick comes so long after the start: the thread has its priority then."""
BIN_NS = 1000
"""Width of a bin of the lateness histogram; the last bin holds all that is later."""


@kernel
def record_row(ring: FloatArray, numbers: Any, row: FloatArray) -> None:
    """Add a row to the ring; HEAD counts the rows that are whole."""
    head = load_ordered(numbers, HEAD)
    begin = (head % len(ring)) * ROW
    for k in range(ROW):
        store_relaxed(ring, begin + k, row[k])
    store_release(numbers, HEAD, head + 1)


@kernel
def _answer_rearm(numbers: Any, supervisor: FloatArray, limits: FloatArray, codes: Any, t_s: float) -> None:
    asked = load_ordered(numbers, REARM_ASKED)
    if asked == load_ordered(numbers, REARM_ANSWERED):
        return
    store_ordered(numbers, REARM_ANSWER, rearm(supervisor, limits, codes, t_s))
    store_ordered(numbers, REARM_ANSWERED, asked)


@kernel
def _too_many_late(late_ticks: Any, tick: int) -> bool:
    """Note a late tick; whether it is the third of the last hundred."""
    for k in range(LATE_TICKS - 1):
        late_ticks[k] = late_ticks[k + 1]
    late_ticks[LATE_TICKS - 1] = tick
    return bool(late_ticks[0] > tick - LATE_WITHIN)


@kernel
def _write(device: Any, context: Any, numbers: Any, now_ns: int, force: FloatArray, zero: FloatArray) -> int:
    """Send a force, unless the watchdog has tripped: before, or while the device took it."""
    if load_ordered(numbers, TRIPPED) == 0:
        failed = call_device(device[1], context, now_ns, force)
        if load_ordered(numbers, TRIPPED) == 0:
            return int(failed)
    return int(call_device(device[1], context, now_ns, zero))


@kernel
def _trip(device: Any, context: Any, numbers: Any, now_ns: int, zero: FloatArray) -> None:
    """It trips before it sends: a servo that wakes up meanwhile sends no force either (`_write`)."""
    store_ordered(numbers, TRIPPED, 1)
    call_device(device[1], context, now_ns, zero)


@kernel
def run_servo(
    bound: Any,
    scratch: Any,
    device: Any,
    context: Any,
    counter: Any,
    shared: FloatArray,
    numbers: Any,
    ring: FloatArray,
    histogram: Any,
    period_ns: int,
    start_ns: int,
    simulated_late_ns: Any,
) -> int:
    """Tick once a period until STOP, then send no force; or a number of ticks in simulated time.

    Args:
        bound, scratch: of `servo_tick`.
        device: (2,) int64 addresses of read and write; context: the device's own.
        counter, shared: what the session publishes, under a sequence lock.
        numbers: (NUMBERS,) int64 shared with Python and the watchdog.
        ring: (n, ROW) record; histogram: (b,) int64 counts of lateness in µs.
        start_ns: deadline of the first tick in simulated time, in which a tick takes none.
        simulated_late_ns: (n,) int64 lateness of each tick in simulated time; (0,) in real time.
    Returns:
        ticks that ran.
    """
    timespec, late_ticks = np.zeros(2, dtype=np.int64), np.zeros(LATE_TICKS, dtype=np.int64)
    late_ticks[:] = -LATE_WITHIN
    inputs, read_work = np.zeros(len(shared)), np.zeros(len(shared))
    xyz, force, zero, row = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(ROW)
    bound, scratch = borrowed(bound), borrowed(scratch)
    memory, limits, codes = scratch[0], bound[5], bound[6]
    supervisor = memory[SUPERVISION:TOOL]
    missed = codes[MISSED_DEADLINES]
    wake_exactly()
    seen = read_shared(counter, shared, -1, inputs, read_work)
    ticks, overran, done = 0, False, 0
    simulated_ticks = len(simulated_late_ns)
    simulated, limit_ns = simulated_ticks > 0, load_ordered(numbers, LATE_NS)
    target = start_ns if simulated else monotonic_ns(timespec) + SETTLE_NS
    while load_ordered(numbers, STOP) == 0 and not (simulated and ticks == simulated_ticks):
        if simulated:
            now = max(target, done) + simulated_late_ns[ticks]
            limit = load_ordered(numbers, WATCHDOG_NS)
            if ticks > 0 and 0 < limit < now - done and load_ordered(numbers, TRIPPED) == 0:
                _trip(device, context, numbers, done + limit, zero)
        else:
            now = sleep_until(target, timespec)
        late = now - target
        histogram[min(late // BIN_NS, len(histogram) - 1)] += 1
        if late > load_ordered(numbers, WORST_NS):
            store_relaxed(numbers, WORST_NS, late)
        found = 0
        if (late > limit_ns or overran) and _too_many_late(late_ticks, ticks):
            found |= missed
        if load_ordered(numbers, TRIPPED) != 0:
            found |= missed
        seen = read_shared(counter, shared, seen, inputs, read_work)
        _answer_rearm(numbers, supervisor, limits, codes, now * 1e-9)
        device_status = call_device(device[0], context, now, xyz)
        unpacked_tick(*bound, inputs, xyz, device_status, now * 1e-9, found, *scratch, row, force)
        _write(device, context, numbers, now, force, zero)
        done = now if simulated else monotonic_ns(timespec)
        store_ordered(numbers, HEARTBEAT_NS, done)
        row[LATENESS_NS], row[WORK_NS], row[TICK] = late, done - now, ticks
        record_row(ring, numbers, row)
        ticks += 1
        target += period_ns
        overran = done - target > limit_ns
        while target < done - period_ns:
            target += period_ns
            numbers[SKIPPED] += 1
    if not simulated:
        call_device(device[1], context, monotonic_ns(timespec), zero)
    return ticks


@kernel
def watch(device: Any, context: Any, numbers: Any, limit_ns: int, check_ns: int) -> None:
    """The watchdog: no tick has ended for `limit_ns`: no force, at once, until a new servo is started."""
    timespec, zero = np.zeros(2, dtype=np.int64), np.zeros(3)
    target = monotonic_ns(timespec)
    while load_ordered(numbers, STOP) == 0:
        target += check_ns
        now = sleep_until(target, timespec)
        last = load_ordered(numbers, HEARTBEAT_NS)
        if last > 0 and now - last > limit_ns and load_ordered(numbers, TRIPPED) == 0:
            _trip(device, context, numbers, now, zero)


@kernel
def measure_floor(numbers: Any, histogram: Any, period_ns: int) -> int:
    """An empty loop with the servo's sleep: the lateness that the machine itself has; ticks that ran."""
    timespec = np.zeros(2, dtype=np.int64)
    wake_exactly()
    target, ticks = monotonic_ns(timespec) + SETTLE_NS, 0
    while load_ordered(numbers, STOP) == 0:
        late = sleep_until(target, timespec) - target
        histogram[min(late // BIN_NS, len(histogram) - 1)] += 1
        if late > load_ordered(numbers, WORST_NS):
            store_relaxed(numbers, WORST_NS, late)
        ticks += 1
        target += period_ns
        done = monotonic_ns(timespec)
        while target < done - period_ns:
            target += period_ns
            numbers[SKIPPED] += 1
    return ticks


@kernel
def copy_rows(ring: FloatArray, numbers: Any, begin: int, out: FloatArray) -> int:
    """Rows from number `begin` on into `out`.

    Returns:
        the number after the last whole row; where that is more than `begin + len(out)` rows were left, and
        rows that had been overwritten are NaN.
    """
    head = load_ordered(numbers, HEAD)
    count = min(head - begin, len(out))
    for i in range(count):
        at = ((begin + i) % len(ring)) * ROW
        for k in range(ROW):
            out[i, k] = load_relaxed(ring, at + k)
    fence_acquire()
    # the row after the newest whole one is being written now
    oldest = load_ordered(numbers, HEAD) + 1 - len(ring)
    for i in range(min(count, max(oldest - begin, 0))):
        out[i, :] = np.nan
    end: int = begin + count
    return end
