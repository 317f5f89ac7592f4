"""What the supervisor did over a recording: time in each state, fades, latches, largest step of force."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, IntArray, InvalidInputError
from dvf_ig.core.arrays import check_shape

from .supervisor import SupervisorState


@dataclass(frozen=True, slots=True)
class SupervisionSummary:
    """Counts and times of one recording.

    Attributes:
        ok_s, degraded_s, fade_s, latched_s: time in each state; a state lasts until the next step.
        fades, latches: times that FADE, LATCHED was entered from another state.
        largest_step_n: largest change of the sent force between two steps.
        largest_slew_n_per_s: largest such change over the time between the two.
    """

    ok_s: float
    degraded_s: float
    fade_s: float
    latched_s: float
    fades: int
    latches: int
    largest_step_n: float
    largest_slew_n_per_s: float


def summarise_supervision(t_s: FloatArray, state: IntArray, force_n: FloatArray) -> SupervisionSummary:
    """Summary of a recording of steps.

    Args:
        t_s: (n,) increasing times of the steps, n >= 1.
        state: (n,) SupervisorState values.
        force_n: (n, 3) N, as sent.
    Raises:
        InvalidInputError: shapes that do not fit, or times that do not increase.
    """
    n = len(t_s)
    for array, name, shape in (
        (t_s, "times", (n,)),
        (state, "states", (n,)),
        (force_n, "sent force", (n, 3)),
    ):
        check_shape(array, f"{name} of the supervisor", shape)
    dt_s = np.diff(t_s)
    if n == 0 or not (dt_s > 0.0).all():
        raise InvalidInputError(
            "a summary of the supervisor needs at least one step, and times that increase"
        )
    seconds = {s: float(dt_s[state[:-1] == s].sum()) for s in SupervisorState}
    steps_n = np.linalg.norm(np.diff(force_n, axis=0), axis=1)
    return SupervisionSummary(
        ok_s=seconds[SupervisorState.OK],
        degraded_s=seconds[SupervisorState.DEGRADED],
        fade_s=seconds[SupervisorState.FADE],
        latched_s=seconds[SupervisorState.LATCHED],
        fades=_entries(state, SupervisorState.FADE),
        latches=_entries(state, SupervisorState.LATCHED),
        largest_step_n=float(steps_n.max(initial=0.0)),
        largest_slew_n_per_s=float((steps_n / dt_s).max(initial=0.0)),
    )


def _entries(state: IntArray, entered: SupervisorState) -> int:
    """How often a state begins after another one."""
    return int(np.count_nonzero((state[1:] == entered) & (state[:-1] != entered)))
