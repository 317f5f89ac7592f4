"""The servo's ticks in simulated time, exactly a period apart: for tests, studies and simulated operators."""

import numpy as np

from dvf_ig.core import InvalidInputError
from dvf_ig.guidance.device import COMMON_DEVICE, DeviceLimits
from dvf_ig.guidance.devices.protocol import HapticDevice
from dvf_ig.guidance.fixtures import Fixtures
from dvf_ig.kernels.servo.loop import simulate_servo
from dvf_ig.kernels.servo.tick import ROW

from .bound import bind_fixtures, new_scratch
from .inputs import ServoInputs
from .options import ServoOptions
from .record import ServoRecord

START_NS = 1_000_000_000


class SimulatedServo:
    """The same ticks as `Servo`, run when they are asked for; a device moves along with them.

    Arguments as of `Servo`.
    """

    def __init__(
        self,
        fixtures: Fixtures,
        device: HapticDevice,
        *,
        limits: DeviceLimits = COMMON_DEVICE,
        options: ServoOptions = ServoOptions(),  # noqa: B008  frozen
    ) -> None:
        self.options = options
        self.device = device
        self._bound = tuple(bind_fixtures(fixtures, limits, options, device.latency_s))
        self._scratch = tuple(new_scratch(len(fixtures.parts)))
        self._functions = np.array(device.functions, dtype=np.int64)
        self._ticks = 0

    @property
    def now_s(self) -> float:
        """Time of the next tick, in the session's clock."""
        return self._ticks * self.options.period_ns * 1e-9

    def run(self, inputs: ServoInputs, ticks: int) -> ServoRecord:
        """So many ticks with what a session published; the session's clock begins with the first tick of all.

        Raises:
            InvalidInputError: no tick.
        """
        if ticks < 1:
            raise InvalidInputError(f"{ticks} ticks asked for; needed at least 1")
        rows = np.zeros((ticks, ROW))
        values = inputs.packed(START_NS * 1e-9 + inputs.now_s)
        start_ns = START_NS + self._ticks * self.options.period_ns
        simulate_servo(
            self._bound,
            self._scratch,
            self._functions,
            self.device.context,
            values,
            start_ns,
            self.options.period_ns,
            rows,
        )
        self._ticks += ticks
        return ServoRecord(rows)


def simulate(
    fixtures: Fixtures,
    device: HapticDevice,
    inputs: ServoInputs,
    ticks: int,
    *,
    limits: DeviceLimits = COMMON_DEVICE,
    options: ServoOptions = ServoOptions(),  # noqa: B008  frozen
) -> ServoRecord:
    """One run with the same inputs throughout."""
    return SimulatedServo(fixtures, device, limits=limits, options=options).run(inputs, ticks)
