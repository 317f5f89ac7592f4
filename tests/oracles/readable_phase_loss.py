"""A lost cardiac phase in readable form: guidance fades, walls become those of the worst phase, and back."""

import math

from dvf_ig.guidance import Status
from dvf_ig.guidance.supervision.supervisor import FADE_S


class PhaseLoss:
    """How far a force has crossed from the fixtures at a known phase to the walls at their worst phase.

    Attributes:
        last_phase: the last known phase of the model; NaN before the first.
        share: of the worst-phase walls in the force, a raised cosine in time.
    """

    def __init__(self) -> None:
        self.last_phase = math.nan
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
            self.last_phase, self._progress = math.nan, 0.0
            return
        target, most = float(status == Status.NO_PHASE), dt_s / FADE_S
        if math.isnan(self.last_phase):
            self._progress = target
        self._progress += min(max(target - self._progress, -most), most)
        if status == Status.OK:
            self.last_phase = model_phase
