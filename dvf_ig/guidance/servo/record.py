"""What a servo did, tick by tick."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, IntArray, read_only_arrays
from dvf_ig.guidance.supervision.hazards import Hazard
from dvf_ig.guidance.supervision.supervisor import SupervisorState
from dvf_ig.kernels.servo import record as kernel


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SentForce:
    """The force that a servo sent last, and why, for those who pass it on.

    Attributes:
        t_s: the session's time of its tick.
        force_n: (3,) tracker frame.
        state: of the servo's supervisor.
        hazards: met since the last report, and those for which the force is still withheld.
    """

    t_s: float
    force_n: FloatArray
    state: SupervisorState
    hazards: Hazard


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ServoRecord:
    """Rows of the servo's ring buffer, one a tick; columns at the offsets of `dvf_ig.kernels.servo.record`.

    Attributes:
        rows: (n, ROW).
    """

    rows: FloatArray

    def __len__(self) -> int:
        return len(self.rows)

    def _column(self, at: int) -> FloatArray:
        return np.asarray(self.rows[:, at])

    @property
    def t_s(self) -> FloatArray:
        """(n,) the session's time at which each position was read."""
        return self._column(kernel.T_S)

    @property
    def xyz_mm(self) -> FloatArray:
        """(n, 3) measured tool, tracker frame."""
        return np.asarray(self.rows[:, kernel.XYZ_MM : kernel.XYZ_MM + 3])

    @property
    def field_n(self) -> FloatArray:
        """(n, 3) composed force of the fixtures, tracker frame."""
        return np.asarray(self.rows[:, kernel.FIELD_N : kernel.FIELD_N + 3])

    @property
    def wanted_n(self) -> FloatArray:
        """(n, 3) with damping and the passivity controller's force, within the cap."""
        return np.asarray(self.rows[:, kernel.WANTED_N : kernel.WANTED_N + 3])

    @property
    def sent_n(self) -> FloatArray:
        """(n, 3) what the supervisor let through."""
        return np.asarray(self.rows[:, kernel.SENT_N : kernel.SENT_N + 3])

    @property
    def distance_mm(self) -> FloatArray:
        """(n,) of the primary fixture; at NO_PHASE of the first wall at its worst phase; else NaN."""
        return self._column(kernel.DISTANCE_MM)

    @property
    def status(self) -> IntArray:
        """(n,) `Status`."""
        return self._column(kernel.STATUS).astype(np.int64)

    @property
    def state(self) -> IntArray:
        """(n,) `SupervisorState`."""
        return self._column(kernel.STATE).astype(np.int64)

    @property
    def hazards(self) -> IntArray:
        """(n,) bits of `Hazard`."""
        return self._column(kernel.ACTIVE_HAZARDS).astype(np.int64)

    @property
    def cause(self) -> IntArray:
        """(n,) bits of `Hazard`: what began the running fade or latch, or joined the fade."""
        return self._column(kernel.CAUSE).astype(np.int64)

    def newest(self) -> SentForce | None:
        """The last tick's force; its reason while it is latched, however long ago that was found."""
        if len(self) == 0:
            return None
        hazards = int(np.bitwise_or.reduce(self.hazards) | self.cause[-1])
        return SentForce(
            float(self.t_s[-1]), self.sent_n[-1].copy(), SupervisorState(self.state[-1]), Hazard(hazards)
        )

    @property
    def residual_mj(self) -> FloatArray:
        """(n,) energy of the passivity observer not yet taken back."""
        return self._column(kernel.RESIDUAL_MJ)

    @property
    def given_mj(self) -> FloatArray:
        """(n,) work done on the hand since the start."""
        return self._column(kernel.GIVEN_MJ)

    @property
    def by_surface_mj(self) -> FloatArray:
        """(n,) the part of that done by the surface's motion."""
        return self._column(kernel.BY_SURFACE_MJ)

    @property
    def lateness_us(self) -> FloatArray:
        """(n,) time of waking after the deadline."""
        return self._column(kernel.LATENESS_NS) / 1e3

    @property
    def work_us(self) -> FloatArray:
        """(n,) from waking to the force having been sent."""
        return self._column(kernel.WORK_NS) / 1e3
