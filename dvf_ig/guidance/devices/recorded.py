"""A recorded motion in place of a haptic device: positions played back, forces kept."""

from typing import Any

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.core.arrays import check_shape
from dvf_ig.kernels.servo import recorded as kernel


class RecordedDevice:
    """Plays positions back at their rate from the first read on, and keeps the force sent beside each.

    After the last sample it no longer answers, as a device that was unplugged.

    Args:
        position_mm: (n, 3) frame "device".
        rate_hz: of the samples.
    Raises:
        InvalidInputError: no sample, or a rate that is not positive.
    """

    latency_s = 0.0

    def __init__(self, position_mm: Any, rate_hz: float, *, name: str = "recorded device") -> None:
        position = np.array(position_mm, dtype=np.float64)
        check_shape(position, "recorded positions", (None, 3))
        if len(position) == 0 or not (np.isfinite(rate_hz) and rate_hz > 0.0):
            raise InvalidInputError(
                "a recorded device needs at least one position and a rate; got "
                f"{len(position)} at {rate_hz:g} Hz"
            )
        self.name = name
        self.functions = np.array([kernel.read_recorded.address, kernel.write_recorded.address])
        self.context = np.zeros(kernel.HEADER + 6 * len(position), dtype=np.int64)
        numbers = self.context.view(np.float64)
        numbers[kernel.COUNT], numbers[kernel.PERIOD_S] = len(position), 1.0 / rate_hz
        numbers[kernel.HEADER : kernel.HEADER + position.size] = position.ravel()

    @property
    def force_n(self) -> FloatArray:
        """(n, 3) N, the force sent while each position was the last; zero if there was none."""
        numbers = self.context.view(np.float64)
        return numbers[kernel.HEADER + len(numbers[kernel.HEADER :]) // 2 :].reshape(-1, 3).copy()

    def close(self) -> None:
        """No resource is open."""
