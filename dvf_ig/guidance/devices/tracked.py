"""A tracked tool in place of a haptic device: the servo reads its predicted tip, others render the force."""

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.kernels.servo import tracked as kernel


class TrackedTool:
    """The tip that a session predicts, in the frame "tracker", which is the frame "device" of this one.

    Its force is what the servo's record says; who renders it has a latency that is not known here.
    """

    name = "tracked tool"
    latency_s = 0.0

    def __init__(self) -> None:
        self.functions = np.array([kernel.read_tracked.address, kernel.write_tracked.address])
        self.context = np.zeros(kernel.CONTEXT_SIZE, dtype=np.int64)
        self.context[kernel.SEEN] = -1
        self._tip = np.zeros(kernel.TIP_SIZE)

    def publish(self, tip_mm: FloatArray, velocity_mm_s: FloatArray, clock_s: float) -> None:
        """The tip and its velocity at a time of the machine's monotonic clock; from one thread."""
        self._tip[:3], self._tip[3:6], self._tip[6] = tip_mm, velocity_mm_s, clock_s
        kernel.publish_tip(self.context, self._tip)

    def close(self) -> None:
        """Nothing is held open."""
