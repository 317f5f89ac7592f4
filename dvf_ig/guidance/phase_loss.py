"""When the cardiac phase is lost: guidance fades, walls become those of the worst phase, and back again.

`dvf_ig.kernels.servo.phase_loss` is the servo's form, and says what is mixed.
"""

import math

import numpy as np

from dvf_ig.core import FloatArray

from .fixtures import FORCE, TICK_OUTPUT, Fixtures
from .status import Status
from .supervision.supervisor import FADE_S


class PhaseLoss:
    """How far a force has crossed from the fixtures at a known phase to the walls at their worst phase.

    Attributes:
        held_phase: the last known phase of the model; NaN before the first.
        share: of the worst-phase walls in the force, a raised cosine in time.
    """

    def __init__(self) -> None:
        self.held_phase = math.nan
        self._progress = 0.0

    @property
    def share(self) -> float:
        return 0.5 * (1.0 - math.cos(math.pi * self._progress))

    def step(self, dt_s: float, status: Status, model_phase: float) -> None:
        """One more tick.

        Args:
            dt_s: since the last tick.
            status: without force, at any but OK and NO_PHASE, there is nothing to cross from.
            model_phase: where the status is OK.
        """
        if status not in (Status.OK, Status.NO_PHASE):
            self.held_phase, self._progress = math.nan, 0.0
            return
        target, most = float(status == Status.NO_PHASE), dt_s / FADE_S
        if math.isnan(self.held_phase):
            self._progress = target
        self._progress += min(max(target - self._progress, -most), most)
        if status == Status.OK:
            self.held_phase = model_phase


class FixturesOverTime:
    """`Fixtures.tick` at one time after the other, through losses of the phase.

    Without a forbidden region a lost phase leaves no force, and the supervisor fades what was sent.
    """

    def __init__(self, fixtures: Fixtures) -> None:
        self._fixtures = fixtures
        self._loss = PhaseLoss()
        self._last_s = math.inf
        self._other = np.empty(TICK_OUTPUT)

    def widen(self, margin_mm: FloatArray) -> None:
        """As `Fixtures.widen`."""
        self._fixtures.widen(margin_mm)

    def tick(
        self,
        t_s: float,
        model_from_query: FloatArray,
        xyz_mm: FloatArray,
        model_phase: float,
        input_status: int,
        out: FloatArray,
    ) -> int:
        """As `Fixtures.tick`, at a time not before the last; at NO_PHASE the distance is of a wall."""
        tick, loss = self._fixtures.tick, self._loss
        found = tick(model_from_query, xyz_mm, model_phase, input_status, out)
        if not self._fixtures.walls:
            return found
        loss.step(max(0.0, t_s - self._last_s), Status(found), model_phase)
        self._last_s = t_s
        if found == Status.OK and loss.share > 0.0:
            known, share = int(Status.NO_PHASE), loss.share
        elif found == Status.NO_PHASE and loss.share < 1.0:
            known, share = int(Status.OK), 1.0 - loss.share
        else:
            return found
        if tick(model_from_query, xyz_mm, loss.held_phase, known, self._other) == known:
            out[FORCE] += share * (self._other[FORCE] - out[FORCE])
        return found
