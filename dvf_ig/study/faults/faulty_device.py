"""A haptic device that is moved along given places and fails where it is told to; what it is sent is kept."""

from typing import Any

import numpy as np
from numba import carray

from dvf_ig.core import BoolArray, FloatArray
from dvf_ig.kernels.servo.device_call import device_function

COUNT, START_NS, WRITTEN, HEADER = 0, 1, 2, 8
"""Offsets in its context, float64 in an int64 array; then 4 numbers a sample and 4 a write."""
RATE_HZ = 1000.0
WRITES_A_SAMPLE = 2
"""Room for those of the loop and of the watchdog."""


@device_function
def _read(context: Any, now_ns: int, out: Any) -> int:
    """The sample of that time since the first read; not 0 where the device does not answer."""
    header = carray(context, HEADER, np.float64)
    position = carray(out, 3)
    if header[START_NS] == 0.0:
        header[START_NS] = float(now_ns)
    count = int(header[COUNT])
    at = min(int((now_ns - header[START_NS]) * 1e-9 * RATE_HZ + 1e-6), count - 1)
    samples = carray(context, HEADER + 4 * count, np.float64)
    for k in range(3):
        position[k] = samples[HEADER + 4 * at + k]
    return int(samples[HEADER + 4 * at + 3])


@device_function
def _write(context: Any, now_ns: int, force_n: Any) -> int:
    """Note when a force was sent, and the force."""
    header = carray(context, HEADER, np.float64)
    force = carray(force_n, 3)
    count, written = int(header[COUNT]), int(header[WRITTEN])
    if written >= WRITES_A_SAMPLE * count:
        return 0
    log = carray(context, HEADER + 4 * count + 4 * WRITES_A_SAMPLE * count, np.float64)
    at = HEADER + 4 * count + 4 * written
    log[at] = (now_ns - header[START_NS]) * 1e-9
    for k in range(3):
        log[at + 1 + k] = force[k]
    header[WRITTEN] = float(written + 1)
    return 0


class FaultyDevice:
    """A `HapticDevice` of RATE_HZ samples.

    Args:
        position_mm: (n, 3) frame "device".
        silent: (n,) True where it does not answer.
    """

    name, latency_s = "faulty device", 0.0

    def __init__(self, position_mm: FloatArray, silent: BoolArray) -> None:
        n = len(position_mm)
        self.functions = np.array([_read.address, _write.address])
        self.context = np.zeros(HEADER + 4 * n * (1 + WRITES_A_SAMPLE), dtype=np.int64)
        numbers = self.context.view(np.float64)
        numbers[COUNT] = n
        samples = numbers[HEADER : HEADER + 4 * n].reshape(n, 4)
        samples[:, :3], samples[:, 3] = position_mm, silent

    @property
    def sent(self) -> FloatArray:
        """(m, 4) time since the first read, s, and force sent, N, in order of time."""
        numbers = self.context.view(np.float64)
        begin = HEADER + 4 * int(numbers[COUNT])
        return numbers[begin : begin + 4 * int(numbers[WRITTEN])].reshape(-1, 4).copy()

    def close(self) -> None:
        """Nothing is held open."""
