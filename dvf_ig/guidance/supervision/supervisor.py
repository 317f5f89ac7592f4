"""Supervisor of the force: states, answers, times and limits (docs/theory/safety.md).

`dvf_ig.kernels.servo.supervision` is the supervisor. A fade releases the force that was last sent, whatever
is wanted meanwhile, and once begun it runs to zero even if its hazard goes: a hazard that flickers would
otherwise never withdraw the force. A faster fade replaces a slower one if it ends earlier. The force then
comes back at 6 N/s until it has caught up with the wanted one; so it does at the start. A latch takes effect
at the end of its fade. What is sent never exceeds the larger of what was wanted and what was sent before, so
a cap on the wanted force is one on the sent force.
"""

from dataclasses import dataclass
from enum import Enum, IntEnum

import numpy as np

from dvf_ig.core import FloatArray, IntArray, InvalidInputError, read_only_arrays
from dvf_ig.core.arrays import check_shape

from .hazards import Hazard

FADE_S = 0.250
"""A hand of 100 N/m that lets go of 0.6 N within this time moves 6 mm, 7 with overshoot."""
FAST_FADE_S = 0.020
SLEW_SPEED_M_S = 0.25
"""Slew limit = device stiffness × this speed: 100 N/s at 400 N/m; a beating wall alone needs 10 to 30."""
SLOW_SLEW_N_PER_S = 6.0
"""While the force comes back after a fade or a re-arm, and while a registration update is under way."""
CLAMPS_WITHIN_S = 1.0
LATCH_AFTER_S = 1.0
REARM_BELOW_N = 0.2
REARM_RISE_S = 0.5
REARM_AGE_S = 0.1
"""A re-arm is judged by the last step, which may be no older than this."""


class SupervisorState(IntEnum):
    """State of the supervised force."""

    OK = 0
    """The force is given."""
    DEGRADED = 1
    """The force is given with a warning, or follows at 6 N/s: it comes back, or the pose is being updated."""
    FADE = 2
    """The last sent force is released, then nothing is sent while a hazard withholds the force."""
    LATCHED = 3
    """No force is sent until an operator re-arms."""


class RearmAnswer(Enum):
    """Answer to a re-arm; each value is the sentence a user reads."""

    ACCEPTED = "re-armed; the force rises within half a second"
    NOT_LATCHED = "nothing to re-arm: the force is not latched"
    NO_RECENT_STEP = "not re-armed: the last step of the force is more than 0.1 s old"
    HAZARD_ACTIVE = "not re-armed: what withholds the force has not gone; re-arm again when it has"
    FORCE_WANTED = "not re-armed: the fixture asks for 0.2 N or more; move the tool away and re-arm again"


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SupervisedForce:
    """Force sent to the device, with its reasons.

    Attributes:
        force_n: (3,) N, read-only, in the frame of the wanted force; always finite.
        state: what may become of the force.
        hazards: active in this step, those found by the supervisor included.
        cause: hazards that began the running fade or latch, or joined the fade; NONE in OK and DEGRADED.
        scale: in [0, 1]: share of the force at the fade's beginning, or of the wanted one during a rise after
            a re-arm; 0 after a fade; otherwise 1.
        clamped: the slew limit cut this step, and it was counted.
    """

    force_n: FloatArray
    state: SupervisorState
    hazards: Hazard
    cause: Hazard
    scale: float
    clamped: bool

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences for the user: active hazards, and those for which the force is still withheld."""
        return (self.hazards | self.cause).sentences


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
