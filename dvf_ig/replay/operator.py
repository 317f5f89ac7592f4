"""The operator of a replay: re-arms the supervisor some time after what latched it has gone."""

from dataclasses import dataclass

from dvf_ig.guidance import WITHHOLDING, SupervisorState
from dvf_ig.session import GuidanceState, Rearm

REARM_AFTER_S = 1.0
"""A recording holds no operator. This one waits so long after the hazards have gone, and between requests."""


@dataclass(slots=True)
class SimulatedOperator:
    """Watches the state and asks for force again."""

    _clear_since_s: float | None = None

    def action(self, state: GuidanceState) -> Rearm | None:
        """Choose the action of the operator now."""
        if state.supervisor is not SupervisorState.LATCHED or state.supervised.hazards & WITHHOLDING:
            self._clear_since_s = None
            return None
        if self._clear_since_s is None:
            self._clear_since_s = state.now_s
        if state.now_s - self._clear_since_s < REARM_AFTER_S:
            return None
        self._clear_since_s = state.now_s
        return Rearm(state.now_s)
