"""A haptic device at rest that notes every force, and waits in a read or a write where it is told to."""

from typing import Any

import numpy as np
from numba import carray

from dvf_ig.core import IntArray
from dvf_ig.kernels.servo.clock import monotonic_ns, sleep_until
from dvf_ig.kernels.servo.foreign import device_function

COUNT, READS, SLOW_READ, SLOW_WRITE, WAIT_NS, HEADER = 0, 1, 2, 3, 4, 8
"""Offsets in its context; then (3,) for each force: when it came, its tick's time, ns, and its size, nN."""
KEPT = 200_000
X_MM = 14.0


@device_function
def _read(context: Any, now_ns: int, out: Any) -> int:
    c, position = carray(context, HEADER, np.int64), carray(out, 3)
    position[0], position[1], position[2] = X_MM, 0.0, 0.0
    c[READS] += 1
    if c[READS] == c[SLOW_READ]:
        timespec = np.zeros(2, dtype=np.int64)
        sleep_until(monotonic_ns(timespec) + c[WAIT_NS], timespec)
    return 0


@device_function
def _write(context: Any, now_ns: int, force_n: Any) -> int:
    c, force = carray(context, HEADER + 3 * KEPT, np.int64), carray(force_n, 3)
    timespec = np.zeros(2, dtype=np.int64)
    at = HEADER + 3 * (c[COUNT] % KEPT)
    c[at], c[at + 1] = monotonic_ns(timespec), now_ns
    c[at + 2] = int(1e9 * (abs(force[0]) + abs(force[1]) + abs(force[2])))
    c[COUNT] += 1
    if c[SLOW_WRITE] != 0 and c[at + 2] != 0 and c[READS] >= c[SLOW_WRITE]:
        c[SLOW_WRITE] = 0
        sleep_until(monotonic_ns(timespec) + c[WAIT_NS], timespec)
    return 0


class LoggingDevice:
    """A `HapticDevice` at (X_MM, 0, 0).

    Args:
        slow_read: number of the read that takes `wait_s`; slow_write: of the read after which the next write
            of a force does. 0: none.
    """

    name, latency_s = "logging device", 0.0

    def __init__(self, slow_read: int = 0, slow_write: int = 0, wait_s: float = 0.0) -> None:
        self.context = np.zeros(HEADER + 3 * KEPT, dtype=np.int64)
        self.context[[SLOW_READ, SLOW_WRITE, WAIT_NS]] = slow_read, slow_write, round(1e9 * wait_s)
        self.functions = np.array([_read.address, _write.address])

    @property
    def writes(self) -> int:
        return int(self.context[COUNT])

    @property
    def log(self) -> IntArray:
        """(n, 3) as HEADER says."""
        count = min(self.writes, KEPT)
        return self.context[HEADER : HEADER + 3 * count].reshape(-1, 3).copy()

    def close(self) -> None:
        """Nothing is held open."""
