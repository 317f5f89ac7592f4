"""Hazards of pose, phase, tracking and time: what each does to the force (docs/theory/safety.md)."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import STRICT, Enum, IntFlag
from types import MappingProxyType

from dvf_ig.guidance.places import Status


class Hazard(IntFlag, boundary=STRICT):
    """Causes of an unsafe or doubtful force; several may be active at once. `HAZARD_RULES` is the table."""

    NONE = 0
    STALE_TOOL = 1 << 0
    TOOL_LOST = 1 << 1
    TOOL_FROZEN = 1 << 2
    LATENCY_JUMP = 1 << 3
    CLOCK_BACKWARDS = 1 << 4
    REORDERED_STAMPS = 1 << 5
    CLOCK_SKEW = 1 << 6
    NO_PHASE = 1 << 7
    NO_POSE = 1 << 8
    POSE_UNCONFIRMED = 1 << 9
    POSE_CONTRADICTED = 1 << 10
    POSE_MOVING = 1 << 11
    OUT_OF_VOLUME = 1 << 12
    NOT_FINITE = 1 << 13
    FORCE_CLAMPED = 1 << 14
    SESSION_SILENT = 1 << 15
    DEVICE_LOST = 1 << 16
    ENERGY = 1 << 17
    MISSED_DEADLINES = 1 << 18
    TOOL_CONTRADICTED = 1 << 19
    BREATHING = 1 << 20

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences for the user, one for each active hazard."""
        return tuple(HAZARD_RULES[hazard].sentence for hazard in self)


class Response(Enum):
    """Immediate response to a hazard; each value is the sentence a user reads."""

    WARN = "the force is given in full, with a warning"
    SLOW = "the force changes by at most 6 N/s"
    FADE = "the force fades within 250 ms"
    WALLS = "guidance fades within 250 ms, walls become those of the worst phase; without a wall all fades"
    FAST_FADE = "the force fades within 20 ms"
    NO_FORCE = "the force is zero at once"


class Latch(Enum):
    """When a hazard keeps the force at zero until an operator re-arms."""

    NEVER = "never"
    AFTER_1_S = "after 1 s"
    AT_ONCE = "at once"


@dataclass(frozen=True, slots=True)
class HazardRule:
    """One row of the table.

    Attributes:
        response: to the force.
        latch: when the force stays at zero after the hazard has gone.
        sentence: what a user reads.
    """

    response: Response
    latch: Latch
    sentence: str


HAZARD_RULES: Mapping[Hazard, HazardRule] = MappingProxyType(
    {
        Hazard.STALE_TOOL: HazardRule(
            Response.FADE, Latch.AFTER_1_S, "the tool's newest pose is older than 2.5 frames or 50 ms"
        ),
        Hazard.TOOL_LOST: HazardRule(Response.FADE, Latch.AFTER_1_S, "the tracker does not see the tool"),
        Hazard.TOOL_FROZEN: HazardRule(
            Response.FADE, Latch.AFTER_1_S, "the tool's pose has not changed by a bit for 5 frames or more"
        ),
        Hazard.LATENCY_JUMP: HazardRule(
            Response.FADE, Latch.NEVER, "tool poses arrive so late that the tool may be 0.3 mm further on"
        ),
        Hazard.CLOCK_BACKWARDS: HazardRule(
            Response.FADE,
            Latch.AFTER_1_S,
            "a source's clock went back; its samples are refused until it has run on for 2 s",
        ),
        Hazard.REORDERED_STAMPS: HazardRule(
            Response.WARN, Latch.NEVER, "more than 10 % of a source's samples come twice or out of order"
        ),
        Hazard.CLOCK_SKEW: HazardRule(
            Response.WARN, Latch.NEVER, "a source's clock runs away from the local one; the local one is used"
        ),
        Hazard.NO_PHASE: HazardRule(
            Response.WALLS, Latch.NEVER, "the cardiac phase is not locked: the ECG is off or irregular"
        ),
        Hazard.NO_POSE: HazardRule(Response.FADE, Latch.NEVER, "the patient is not registered"),
        Hazard.POSE_UNCONFIRMED: HazardRule(
            Response.FADE, Latch.NEVER, "no ultrasound has confirmed the pose for too long; scan the heart"
        ),
        Hazard.BREATHING: HazardRule(
            Response.FADE, Latch.NEVER, "the heart's place in the breath is not known"
        ),
        Hazard.POSE_CONTRADICTED: HazardRule(
            Response.FADE, Latch.NEVER, "ultrasound contradicts the pose; scan the heart to register again"
        ),
        Hazard.POSE_MOVING: HazardRule(
            Response.SLOW, Latch.NEVER, "a registration update is under way; the force follows slowly"
        ),
        Hazard.OUT_OF_VOLUME: HazardRule(
            Response.FADE,
            Latch.NEVER,
            "unprotected: the tool is outside the box of the model, or at a part that no MR slice shows",
        ),
        Hazard.NOT_FINITE: HazardRule(
            Response.FAST_FADE, Latch.AT_ONCE, "a pose, a distance or the force was not a finite number"
        ),
        Hazard.FORCE_CLAMPED: HazardRule(
            Response.FADE, Latch.AT_ONCE, "the force jumped: ten of its steps within 1 s had to be cut"
        ),
        Hazard.SESSION_SILENT: HazardRule(
            Response.FADE, Latch.AFTER_1_S, "nothing has been heard from the session for 0.1 s"
        ),
        Hazard.DEVICE_LOST: HazardRule(
            Response.FAST_FADE, Latch.AT_ONCE, "the haptic device does not answer"
        ),
        Hazard.ENERGY: HazardRule(
            Response.FADE, Latch.AT_ONCE, "the fixture gave the hand more than 5 mJ that it had not stored"
        ),
        Hazard.MISSED_DEADLINES: HazardRule(
            Response.NO_FORCE,
            Latch.AT_ONCE,
            "the servo was late by 2 ms in 3 of 100 ticks or silent for 10 ms",
        ),
        Hazard.TOOL_CONTRADICTED: HazardRule(
            Response.FADE,
            Latch.AFTER_1_S,
            "the tool's poses jump to and fro: two programs send it; end one of them",
        ),
    }
)
"""Where docs/theory/safety.md is silent:

- The supervisor sees one composed force, so a latency that asks for guidance alone to fade fades all of it.
- NO_PHASE withholds nothing where there is a forbidden region: what composes the force crosses within 250 ms
  from all fixtures at the last known phase to the forbidden regions at their worst phase, and back when the
  phase is locked again (`dvf_ig.kernels.servo.fixtures`). Without a forbidden region nothing would be left of
  the force, and it fades. The pose still ages: beats without a phase confirm nothing, and after 5 s at most
  POSE_UNCONFIRMED fades the walls, too.
- Pose and phase never latch: what ends them is evidence of its own (a registration that passes its checks,
  beats that confirm it, a locked rhythm), and the force comes back at 6 N/s. Loss of the tool latches after
  1 s because nothing but the tracker says that it is the same tool, unchanged, that has come back.
- A clock that went back counts as a lost tool: until the source runs forward again nothing is known.
- Jumps of force fade in 250 ms, not 20: the numbers are finite, and a hand is behind the device.
"""


def hazards_with(response: Response) -> Hazard:
    """All hazards that have this response."""
    return _union(hazard for hazard, rule in HAZARD_RULES.items() if rule.response is response)


def hazards_that_latch(latch: Latch) -> Hazard:
    """All hazards that latch then."""
    return _union(hazard for hazard, rule in HAZARD_RULES.items() if rule.latch is latch)


def _union(hazards: Iterable[Hazard]) -> Hazard:
    together = Hazard.NONE
    for hazard in hazards:
        together |= hazard
    return together


def hazard_of(status: Status) -> Hazard:
    """Hazard of a force's status; NONE for OK."""
    return _OF_STATUS[status]


_OF_STATUS = {
    Status.OK: Hazard.NONE,
    Status.OUT_OF_VOLUME: Hazard.OUT_OF_VOLUME,
    Status.UNSEEN: Hazard.OUT_OF_VOLUME,
    Status.NO_PHASE: Hazard.NO_PHASE,
    Status.NO_POSE: Hazard.NO_POSE,
    Status.STALE_TOOL: Hazard.STALE_TOOL,
    Status.FAULT: Hazard.NOT_FINITE,
}


def withholding(walls: bool) -> Hazard:
    """Hazards during any of which no force is given.

    Args:
        walls: a forbidden region is among the fixtures; it stays where the phase is lost.
    """
    always = hazards_with(Response.FADE) | hazards_with(Response.FAST_FADE) | hazards_with(Response.NO_FORCE)
    return always if walls else always | hazards_with(Response.WALLS)


WITHHOLDING = withholding(walls=False)
"""Hazards during any of which no force is given where there is no forbidden region."""
