"""Record of a servo's ticks, and how late they were."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray, IntArray, InvalidInputError, read_only_arrays
from dvf_ig.guidance.places import Status
from dvf_ig.guidance.supervision.hazards import Hazard
from dvf_ig.guidance.supervision.supervisor import SupervisedForce, SupervisorState
from dvf_ig.kernels.servo.layout import ROW

BINS = 100_001
"""1 µs each, and one for all later than 0.1 s."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Deadlines:
    """Lateness of a loop's ticks.

    Attributes:
        counts: (BINS,) ticks by whole µs after their deadline.
        worst_us: the latest.
        skipped: deadlines that had passed before their tick could begin.
    """

    counts: IntArray
    worst_us: float
    skipped: int

    @property
    def ticks(self) -> int:
        return int(self.counts.sum())

    @property
    def run_share(self) -> float:
        """Share of the deadlines that had a tick."""
        return self.ticks / max(1, self.ticks + self.skipped)

    def percentile_us(self, percent: float) -> float:
        """Lateness at a percentile of the ticks, rounded up to the end of its bin.

        Raises:
            InvalidInputError: no tick.
        """
        if self.ticks == 0:
            raise InvalidInputError("no tick ran, so there is no lateness; run the loop longer")
        at = int(np.searchsorted(np.cumsum(self.counts), 0.01 * percent * self.ticks))
        return self.worst_us if at >= BINS - 1 else min(self.worst_us, at + 1.0)


def deadlines_of(lateness_us: FloatArray, skipped: int) -> Deadlines:
    """Summarise ticks timed one by one."""
    bins = np.minimum(np.maximum(lateness_us, 0.0).astype(np.int64), BINS - 1)
    return Deadlines(np.bincount(bins, minlength=BINS), float(np.max(lateness_us, initial=0.0)), skipped)


def deadlines_together(parts: Sequence[Deadlines]) -> Deadlines:
    """Summarise the ticks of one or several loops that ran one after another."""
    counts = np.sum([part.counts for part in parts], axis=0)
    return Deadlines(counts, max(part.worst_us for part in parts), sum(part.skipped for part in parts))


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


class ServoTick:
    """One tick: the fixtures at the tool, and the force that the supervisor let through; frame "tracker".

    Args:
        row: (1,) ROW, which is copied.
    """

    __slots__ = ("_row",)

    def __init__(self, row: Any) -> None:
        self._row: Any = np.frombuffer(row.tobytes(), ROW)[0]

    @property
    def status(self) -> Status:
        """Fixtures' status; unless OK the wanted force is zero, except for the walls of NO_PHASE."""
        return Status(int(self._row["status"]))

    @property
    def wanted_n(self) -> FloatArray:
        """(3,) of fixtures, damping and passivity controller, before the supervisor."""
        return np.asarray(self._row["wanted_n"])

    @property
    def sent_n(self) -> FloatArray:
        """(3,) what the supervisor let through."""
        return np.asarray(self._row["sent_n"])

    @property
    def distance_mm(self) -> float:
        """Distance to the primary fixture, positive inside; to the first wall at NO_PHASE; else NaN."""
        return float(self._row["distance_mm"])

    @property
    def gradient(self) -> FloatArray:
        """(3,) of the distance."""
        return np.asarray(self._row["gradient"])

    @property
    def rate_mm_per_cycle(self) -> float:
        """Change of the distance with the model's phase; zero at NO_PHASE, NaN of a path."""
        return float(self._row["rate_mm_per_cycle"])

    @property
    def sigma_mm(self) -> float:
        """Standard deviation of the distance by those of pose and phase."""
        return float(self._row["sigma_mm"])

    @property
    def conflict(self) -> bool:
        """Whether fixtures oppose each other."""
        return bool(self._row["conflict"])

    @property
    def state(self) -> SupervisorState:
        """Supervisor's state."""
        return SupervisorState(int(self._row["state"]))

    @property
    def hazards(self) -> Hazard:
        """Active in this tick: published ones and those that the servo met."""
        return Hazard(int(self._row["hazards"]))

    @property
    def codes(self) -> tuple[int, int, int]:
        """Numbers of status, supervisor's state and active hazards."""
        row = self._row
        return int(row["status"]), int(row["state"]), int(row["hazards"])

    @property
    def supervised(self) -> SupervisedForce:
        """The force sent, and the supervisor's state with what it met."""
        row = self._row
        return SupervisedForce(
            self.sent_n,
            self.state,
            self.hazards,
            Hazard(int(row["cause"])),
            float(row["scale"]),
            bool(row["clamped"]),
        )


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ServoRecord:
    """Rows of the servo's ring buffer, one a tick.

    Attributes:
        rows: (n,) ROW of `dvf_ig.kernels.servo.layout`.
    """

    rows: Any

    def __len__(self) -> int:
        return len(self.rows)

    def _numbers(self, name: str) -> FloatArray:
        return np.asarray(self.rows[name], dtype=np.float64)

    def _codes(self, name: str) -> IntArray:
        return np.asarray(self.rows[name], dtype=np.int64)

    @property
    def t_s(self) -> FloatArray:
        """(n,) the session's time at which each position was read."""
        return self._numbers("t_s")

    @property
    def xyz_mm(self) -> FloatArray:
        """(n, 3) measured tool, tracker frame."""
        return self._numbers("xyz_mm")

    @property
    def field_n(self) -> FloatArray:
        """(n, 3) composed force of the fixtures, tracker frame."""
        return self._numbers("field_n")

    @property
    def wanted_n(self) -> FloatArray:
        """(n, 3) with damping and the passivity controller's force, within the cap."""
        return self._numbers("wanted_n")

    @property
    def sent_n(self) -> FloatArray:
        """(n, 3) what the supervisor let through."""
        return self._numbers("sent_n")

    @property
    def distance_mm(self) -> FloatArray:
        """(n,) of the primary fixture; at NO_PHASE of the first wall at its worst phase; else NaN."""
        return self._numbers("distance_mm")

    @property
    def status(self) -> IntArray:
        """(n,) `Status`."""
        return self._codes("status")

    @property
    def clamped(self) -> IntArray:
        """(n,) 1 where the slew limit cut the tick's step."""
        return self._codes("clamped")

    @property
    def state(self) -> IntArray:
        """(n,) `SupervisorState`."""
        return self._codes("state")

    @property
    def hazards(self) -> IntArray:
        """(n,) bits of `Hazard`."""
        return self._codes("hazards")

    @property
    def cause(self) -> IntArray:
        """(n,) bits of `Hazard`: what began the running fade or latch, or joined the fade."""
        return self._codes("cause")

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
        return self._numbers("residual_mj")

    @property
    def given_mj(self) -> FloatArray:
        """(n,) work done on the hand since the start."""
        return self._numbers("given_mj")

    @property
    def by_surface_mj(self) -> FloatArray:
        """(n,) the part of that done by the surface's motion."""
        return self._numbers("by_surface_mj")

    @property
    def lateness_us(self) -> FloatArray:
        """(n,) time of waking after the deadline."""
        return self._numbers("lateness_ns") / 1e3

    @property
    def work_us(self) -> FloatArray:
        """(n,) from waking to the force having been sent."""
        return self._numbers("work_ns") / 1e3
