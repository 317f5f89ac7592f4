"""The servo's ticks in simulated time, a period apart: for tests, studies and simulated operators."""

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.core.arrays import check_shape
from dvf_ig.guidance.device import COMMON_DEVICE, DeviceLimits
from dvf_ig.guidance.devices.protocol import HapticDevice
from dvf_ig.guidance.fixtures import Fixtures
from dvf_ig.guidance.supervision.supervisor import RearmAnswer
from dvf_ig.kernels.servo import loop as kernel
from dvf_ig.kernels.servo.layout import ROW

from .bound import REARM_ANSWERS
from .inputs import ServoInputs
from .loop_arrays import LoopArrays
from .options import ServoOptions
from .record import ServoRecord
from .servo import LATE_NS

START_NS = 1_000_000_000


class SimulatedServo:
    """Ticks of `Servo`, run on request; a device moves along with them.

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
        self._loop = LoopArrays.of(fixtures, device, limits, options, late_ns=LATE_NS, watched=True)
        self._scratch = self._loop.new_scratch()
        self._ticks = 0

    @property
    def now_s(self) -> float:
        """Time of the next tick, in the session's clock."""
        return self._ticks * self.options.period_ns * 1e-9

    def run(self, inputs: ServoInputs, ticks: int, late_s: FloatArray | None = None) -> ServoRecord:
        """So many ticks with what a session published; the session's clock begins with the first tick of all.

        Args:
            late_s: (ticks,) by which each tick wakes late; None: all on time. Deadlines that pass meanwhile
                are skipped, and the watchdog trips, as in real time. Late ticks are counted within one call.
        Raises:
            InvalidInputError: no tick, or lateness of another number of them.
        """
        if ticks < 1:
            raise InvalidInputError(f"{ticks} ticks asked for; needed at least 1")
        late = np.zeros(ticks) if late_s is None else late_s
        check_shape(late, "lateness of the ticks", (ticks,))
        rows = np.zeros(ticks, ROW)
        skipped = self._loop.numbers[kernel.SKIPPED]
        self._loop.numbers[kernel.HEAD] = 0
        self._loop.publish(inputs, START_NS * 1e-9 + inputs.now_s)
        start_ns = START_NS + self._ticks * self.options.period_ns
        late_ns = np.round(1e9 * late).astype(np.int64)
        kernel.run_servo(*self._loop.arguments(self._scratch, rows, start_ns=start_ns, late_ns=late_ns))
        self._ticks += ticks + int(self._loop.numbers[kernel.SKIPPED] - skipped)
        return ServoRecord(rows)

    @property
    def watchdog_tripped(self) -> bool:
        """No force had been sent for 10 ms at some time: none is sent any more."""
        return bool(self._loop.numbers[kernel.TRIPPED])

    def ask_rearm(self) -> None:
        """An operator's request to leave LATCHED, answered in the next tick (`rearmed`)."""
        self._loop.numbers[kernel.REARM_ASKED] += 1

    @property
    def rearmed(self) -> RearmAnswer | None:
        """Answer to the last request; None before any, and before the tick that answers it."""
        if self._loop.numbers[kernel.REARM_ANSWERED] < max(1, self._loop.numbers[kernel.REARM_ASKED]):
            return None
        return REARM_ANSWERS[int(self._loop.numbers[kernel.REARM_ANSWER])]
