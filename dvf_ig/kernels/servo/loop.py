"""The servo loop, in real or simulated time; the watchdog; the machine's floor."""

from typing import Any

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.kernels.compiled import inlined, kernel

from .borrowed import borrowed, placed
from .clock import elapsed_ns, monotonic_ns, sleep_until, wake_exactly
from .foreign import call_device
from .layout import INPUT_WORDS, ROW_WORDS, WARPS_NUMBER_WORD
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
from .tick import servo_tick, withhold

# Places in the shared numbers: each alone in its cache line.
STOP = 0
SENT_NS = 8
"""When a force was last sent, by `elapsed_ns`, or by simulated time; 0 before the first."""
TRIPPED = 16
"""No force was sent for too long, and a watched servo sends none any more."""
REARM_ASKED = 24
REARM_ANSWERED = 32
REARM_ANSWER = 40
HEAD = 48
SKIPPED = 56
WORST_NS = 64
LATE_NS = 72
"""Set before the start: what counts as late."""
SILENT_NS = 80
"""Set before the start: after so long without a force none is sent, and the servo latches."""
WATCHED = 88
"""Set before the start: not 0 where a watchdog sends no force while the loop hangs."""
NUMBERS = 96

LATE_TICKS = 3
LATE_WITHIN = 100
"""So many ticks that woke late, or came after one that ended late, within so many: no force, latched."""
SETTLE_NS = 20_000_000
"""The first tick comes so long after the start: the thread has its priority then."""
LOST = -1
"""In every word of a row that was overwritten; as a number with a point it is NaN."""
BIN_NS = 1000
"""Width of a bin of the lateness histogram; the last bin holds all that is later."""


@kernel
def record_row(ring: Any, numbers: Any, row: Any) -> None:
    """Add a row, as words, to the ring (n, ROW_WORDS); HEAD counts the rows that are whole."""
    head = load_ordered(numbers, HEAD)
    begin = (head % len(ring)) * ROW_WORDS
    for k in range(ROW_WORDS):
        store_relaxed(ring, begin + k, row[k])
    store_release(numbers, HEAD, head + 1)


@kernel
def _answer_rearm(numbers: Any, bound: Any, scratch: Any, t_s: float) -> None:
    request = load_ordered(numbers, REARM_ASKED)
    if request == load_ordered(numbers, REARM_ANSWERED):
        return
    settings = bound.settings[0]
    answer = rearm(scratch.memory[0].supervision, settings.limits, settings.hazards, t_s)
    store_ordered(numbers, REARM_ANSWER, answer)
    store_ordered(numbers, REARM_ANSWERED, request)


@kernel
def _too_many_late(late_ticks: Any, tick: int) -> bool:
    """Note a late tick; whether it is the third of the last hundred."""
    for k in range(LATE_TICKS - 1):
        late_ticks[k] = late_ticks[k + 1]
    late_ticks[LATE_TICKS - 1] = tick
    return bool(late_ticks[0] > tick - LATE_WITHIN)


@kernel
def silent_too_long(numbers: Any, now_ns: int) -> bool:
    """Whether no force has been sent for SILENT_NS: the one judgement of loop, watchdog and simulated time.

    Args:
        now_ns: by the clock of SENT_NS, read before this call.
    """
    last = load_ordered(numbers, SENT_NS)
    return bool(last != 0 and now_ns - last > load_ordered(numbers, SILENT_NS))


@kernel
def _send_none(device: Any, context: Any, numbers: Any, now_ns: int, zero: FloatArray) -> None:
    """Send no force. A watched servo trips before it sends: a loop that wakes meanwhile sends none either."""
    if load_ordered(numbers, WATCHED) != 0:
        store_ordered(numbers, TRIPPED, 1)
    call_device(device[1], context, now_ns, zero)


@kernel
def _send(
    device: Any,
    context: Any,
    numbers: Any,
    now_ns: int,
    force: FloatArray,
    zero: FloatArray,
    timespec: Any,
    simulated: bool,
) -> bool:
    """Send a force, or none where loop or watchdog find that none was sent for too long; whether it was sent.

    A process may be stopped at any instruction, so both are asked before the device takes the force and again
    after it: a force that was under way when the process was stopped is followed by zero at once.
    """
    before = now_ns if simulated else elapsed_ns(timespec)
    sent = load_ordered(numbers, TRIPPED) == 0 and not silent_too_long(numbers, before)
    if sent:
        call_device(device[1], context, now_ns, force)
    after = now_ns if simulated else elapsed_ns(timespec)
    if not sent or silent_too_long(numbers, after) or load_ordered(numbers, TRIPPED) != 0:
        sent = False
        _send_none(device, context, numbers, now_ns, zero)
    store_ordered(numbers, SENT_NS, after)
    return sent


@inlined
def _read_inputs(counter: Any, shared: Any, seen: int, scratch: Any) -> int:
    """Read what the session has published since the count `seen`; see `read_shared`."""
    read, work = scratch.input_words, scratch.read_words
    return read_shared(counter, shared, seen, read, work, INPUT_WORDS, WARPS_NUMBER_WORD)


@kernel
def run_servo(
    bound: Any,
    scratch: Any,
    device: Any,
    context: Any,
    counter: Any,
    shared: Any,
    numbers: Any,
    ring: Any,
    histogram: Any,
    period_ns: int,
    start_ns: int,
    simulated_late_ns: Any,
) -> int:
    """Tick once a period until STOP, then send no force; or a number of ticks in simulated time.

    Args:
        bound, scratch: `Bound` and `Scratch` of `layout`.
        device: (2,) int64 addresses of read and write; context: the device's own.
        counter, shared: what the session publishes, as words, under a sequence lock.
        numbers: (NUMBERS,) int64 shared with Python and the watchdog.
        ring: (n, ROW_WORDS) record; histogram: (b,) int64 counts of lateness in µs.
        start_ns: deadline of the first tick in simulated time, in which a tick takes none.
        simulated_late_ns: (n,) int64 lateness of each tick in simulated time; (0,) in real time.
    Returns:
        ticks that ran.
    """
    timespec, late_ticks = np.zeros(2, dtype=np.int64), np.zeros(LATE_TICKS, dtype=np.int64)
    late_ticks[:] = -LATE_WITHIN
    xyz, force, zero = np.zeros(3), np.zeros(3), np.zeros(3)
    bound, scratch = borrowed(bound), borrowed(scratch)
    device, context, numbers = borrowed(device), borrowed(context), borrowed(numbers)
    counter, shared, ring = borrowed(counter), borrowed(shared), borrowed(ring)
    bound_at, scratch_at = placed(bound), placed(scratch)
    inputs, row = scratch.inputs[0], scratch.row[0]
    missed = bound.settings[0].hazards.missed_deadlines
    wake_exactly()
    seen = _read_inputs(counter, shared, -1, scratch)
    ticks, overran, sent_ns = 0, False, 0
    simulated_ticks = len(simulated_late_ns)
    simulated, limit_ns = simulated_ticks > 0, load_ordered(numbers, LATE_NS)
    if simulated:
        sent_ns = load_ordered(numbers, SENT_NS)
    target = start_ns if simulated else monotonic_ns(timespec) + SETTLE_NS
    while load_ordered(numbers, STOP) == 0 and not (simulated and ticks == simulated_ticks):
        if simulated:
            now = elapsed = max(target, sent_ns) + simulated_late_ns[ticks]
        else:
            now = sleep_until(target, timespec)
            elapsed = elapsed_ns(timespec)
        late, hazards = now - target, 0
        if silent_too_long(numbers, elapsed):
            # in simulated time when a watchdog would have
            at = sent_ns + load_ordered(numbers, SILENT_NS) if simulated else now
            _send_none(device, context, numbers, at, zero)
            store_ordered(numbers, SENT_NS, elapsed)
            hazards |= missed
        histogram[min(late // BIN_NS, len(histogram) - 1)] += 1
        if late > load_ordered(numbers, WORST_NS):
            store_relaxed(numbers, WORST_NS, late)
        if (late > limit_ns or overran) and _too_many_late(late_ticks, ticks):
            hazards |= missed
        if load_ordered(numbers, TRIPPED) != 0:
            hazards |= missed
        seen = _read_inputs(counter, shared, seen, scratch)
        _answer_rearm(numbers, bound, scratch, now * 1e-9)
        device_status = call_device(device[0], context, now, xyz)
        servo_tick(bound_at, scratch_at, inputs, xyz, device_status, now * 1e-9, hazards, force)
        sent = _send(device, context, numbers, now, force, zero, timespec, simulated)
        if not sent and hazards & missed == 0:
            withhold(bound, scratch, now * 1e-9)
        # a clock less to read: the two differ by a suspension alone, and then the force was not sent
        sent_ns = (
            now + load_relaxed(numbers, SENT_NS) - elapsed if sent or simulated else monotonic_ns(timespec)
        )
        row.lateness_ns, row.work_ns, row.tick = late, sent_ns - now, ticks
        record_row(ring, numbers, scratch.row_words)
        ticks += 1
        target += period_ns
        overran = sent_ns - target > limit_ns
        while target < sent_ns - period_ns:
            target += period_ns
            numbers[SKIPPED] += 1
    if not simulated:
        call_device(device[1], context, monotonic_ns(timespec), zero)
    return ticks


@kernel
def watch(device: Any, context: Any, numbers: Any, check_ns: int) -> None:
    """The watchdog: sends zero force after too long a silence, until a new servo is started."""
    timespec, zero = np.zeros(2, dtype=np.int64), np.zeros(3)
    target = monotonic_ns(timespec)
    while load_ordered(numbers, STOP) == 0:
        target += check_ns
        now = sleep_until(target, timespec)
        if load_ordered(numbers, TRIPPED) == 0 and silent_too_long(numbers, elapsed_ns(timespec)):
            _send_none(device, context, numbers, now, zero)


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
        now = monotonic_ns(timespec)
        while target < now - period_ns:
            target += period_ns
            numbers[SKIPPED] += 1
    return ticks


@kernel
def copy_rows(ring: Any, numbers: Any, begin: int, out: Any) -> int:
    """Rows from number `begin` on into `out`, as words.

    Returns:
        the number after the last whole row; if that is more than `begin + len(out)`, rows were left, and
        rows that had been overwritten are LOST throughout.
    """
    head = load_ordered(numbers, HEAD)
    count = min(head - begin, len(out))
    for i in range(count):
        at = ((begin + i) % len(ring)) * ROW_WORDS
        for k in range(ROW_WORDS):
            out[i, k] = load_relaxed(ring, at + k)
    fence_acquire()
    # the row after the newest whole one is being written now
    oldest = load_ordered(numbers, HEAD) + 1 - len(ring)
    for i in range(min(count, max(oldest - begin, 0))):
        for k in range(ROW_WORDS):
            out[i, k] = LOST
    end: int = begin + count
    return end
