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

from dvf_ig.core import FloatArray, read_only_arrays

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
    """What may become of the force."""

    OK = 0
    """The force is given."""
    DEGRADED = 1
    """The force is given with a warning, or follows at 6 N/s: it comes back, or the pose is being updated."""
    FADE = 2
    """The last sent force is released, then nothing is sent while a hazard withholds the force."""
    LATCHED = 3
    """Nothing is sent until an operator re-arms."""


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
    """What is sent to the device, and why.

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
        """What a user reads: active hazards, and those that the force is still withheld for."""
        return (self.hazards | self.cause).sentences
