"""A recorded haptic device behind the two functions of `device_call`: positions played back, forces kept."""

from typing import Any

import numpy as np
from numba import carray

from .foreign import device_function

# Offsets in its context, float64 numbers in an int64 array; then 3 numbers a sample, then 3 a force.
COUNT = 0
PERIOD_S = 1
START_NS = 2
AT = 3
HEADER = 8


@device_function
def read_recorded(context: Any, now_ns: int, out: Any) -> int:
    """The last sample at that time since the first read; after the last sample the device is gone."""
    header = carray(context, HEADER, np.float64)
    position = carray(out, 3)
    if header[START_NS] == 0.0:
        header[START_NS] = float(now_ns)
    at = int((now_ns - header[START_NS]) * 1e-9 / header[PERIOD_S] + 1e-6)
    count = int(header[COUNT])
    header[AT] = float(min(at, count - 1))
    if at >= count:
        return 1
    samples = carray(context, HEADER + 3 * count, np.float64)
    for k in range(3):
        position[k] = samples[HEADER + 3 * at + k]
    return 0


@device_function
def write_recorded(context: Any, now_ns: int, force_n: Any) -> int:
    """Keep the force beside the sample that was read last."""
    header = carray(context, HEADER, np.float64)
    force = carray(force_n, 3)
    count, at = int(header[COUNT]), int(header[AT])
    samples = carray(context, HEADER + 6 * count, np.float64)
    for k in range(3):
        samples[HEADER + 3 * (count + at) + k] = force[k]
    return 0
