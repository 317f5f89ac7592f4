"""The servo's ticks in simulated time, exactly a period apart: for tests, studies and simulated operators."""

import numpy as np

from dvf_ig.core import InvalidInputError
from dvf_ig.guidance.device import COMMON_DEVICE, DeviceLimits
from dvf_ig.guidance.devices.protocol import HapticDevice
from dvf_ig.guidance.fixtures import Fixtures
from dvf_ig.guidance.supervisor import RearmAnswer
from dvf_ig.kernels.servo import loop as kernel
from dvf_ig.kernels.servo import shared
from dvf_ig.kernels.servo.published import INPUT_SIZE
from dvf_ig.kernels.servo.tick import ROW

from .bound import REARM_ANSWERS, bind_fixtures, new_scratch
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
        self._numbers, self._counter = np.zeros(kernel.NUMBERS, dtype=np.int64), shared.new_counter()
        self._shared, self._histogram = np.zeros(INPUT_SIZE), np.zeros(1, dtype=np.int64)
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
        self._numbers[kernel.HEAD] = 0
        shared.publish(self._counter, self._shared, inputs.packed(START_NS * 1e-9 + inputs.now_s))
        kernel.run_servo(
            self._bound,
            self._scratch,
            self._functions,
            self.device.context,
            self._counter,
            self._shared,
            self._numbers,
            rows,
            self._histogram,
            self.options.period_ns,
            START_NS + self._ticks * self.options.period_ns,
            ticks,
        )
        self._ticks += ticks
        return ServoRecord(rows)

    def ask_rearm(self) -> None:
        """An operator's request to leave LATCHED, answered in the next tick (`rearmed`)."""
        self._numbers[kernel.REARM_ASKED] += 1

    @property
    def rearmed(self) -> RearmAnswer | None:
        """Answer to the last request; None before any, and before the tick that answers it."""
        if self._numbers[kernel.REARM_ANSWERED] < max(1, self._numbers[kernel.REARM_ASKED]):
            return None
        return REARM_ANSWERS[int(self._numbers[kernel.REARM_ANSWER])]


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
