"""The supervisor in readable form; tests hold `dvf_ig.kernels.servo.supervision` to it step by step."""

import math
from collections import deque

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.guidance import (
    DeviceLimits,
    Hazard,
    Latch,
    RearmAnswer,
    Response,
    SupervisedForce,
    SupervisorState,
    withholding,
)
from dvf_ig.guidance.device import COMMON_DEVICE
from dvf_ig.guidance.supervision.hazards import hazards_that_latch, hazards_with
from dvf_ig.guidance.supervision.supervisor import (
    CLAMPS_WITHIN_S,
    FADE_S,
    FAST_FADE_S,
    LATCH_AFTER_S,
    REARM_AGE_S,
    REARM_BELOW_N,
    REARM_RISE_S,
    SLEW_SPEED_M_S,
    SLOW_SLEW_N_PER_S,
)
from dvf_ig.kernels.servo.layout import CLAMPS


class Supervisor:
    """Takes the force that fixtures want and sends the part that is safe. Time comes in with every step.

    A fade releases the force that was last sent, whatever is wanted meanwhile, and once begun it runs to
    zero even if its hazard goes: a hazard that flickers would otherwise never withdraw the force. A faster
    fade replaces a slower one if it ends earlier. The force then comes back at 6 N/s until it has caught up
    with the wanted one; so it does at the start. A latch takes effect at the end of its fade.

    What is sent never exceeds the larger of what was wanted and what was sent before, so a cap on the wanted
    force is one on the sent force. Missed servo deadlines and the watchdog are found by the servo loop, which
    has a clock; it runs this supervisor as a kernel (`dvf_ig.kernels.servo.supervision`).

    Args:
        device: its stiffness gives the slew limit.
        walls: a forbidden region is among the fixtures: NO_PHASE then withholds nothing; what composes the
            wanted force replaces guidance by walls of the worst phase.
    """

    def __init__(self, device: DeviceLimits = COMMON_DEVICE, *, walls: bool = False) -> None:
        self._withholding = withholding(walls)
        self._fading = int(self._withholding)
        self._slew_n_per_s = device.stiffness_n_per_m * SLEW_SPEED_M_S
        self._t_s: float | None = None
        self._sent = (0.0, 0.0, 0.0)
        self._wanted_n = math.inf
        self._hazards = self._cause = Hazard.NONE
        self._state = SupervisorState.DEGRADED
        self._slow = True
        self._latch_due = False
        self._unsafe_since_s: float | None = None
        self._fade_from = (0.0, 0.0, 0.0)
        self._fade_start_s = self._fade_end_s = 0.0
        self._rise_s = self._rise_start_s = 0.0
        self._clamps_s: deque[float] = deque(maxlen=CLAMPS)

    def step(self, t_s: float, wanted_n: FloatArray, hazards: Hazard = Hazard.NONE) -> SupervisedForce:
        """The force to send now.

        Args:
            t_s: not before the last step's; at the same time the force stays the same.
            wanted_n: (3,) N, of the composed fixtures, in the same frame at every step.
            hazards: active now.
        Raises:
            InvalidInputError: time that goes back or is not finite, or a force that is not (3,).
        """
        dt_s = self._elapsed_s(t_s)
        wanted = _components(wanted_n)
        self._wanted_n = math.hypot(*wanted)
        if not math.isfinite(self._wanted_n):
            hazards |= Hazard.NOT_FINITE
        self._hazards = hazards
        bits = int(hazards)
        self._note_latching(t_s, bits)
        if bits & self._fading and self._state is not SupervisorState.LATCHED:
            fade_s = FAST_FADE_S if bits & _FAST else FADE_S
            self._fade(t_s, 0.0 if bits & _AT_ONCE else fade_s)
        scale, clamped = 0.0, False
        if self._state is SupervisorState.FADE:
            scale = self._release(t_s, bits)
        elif self._state is not SupervisorState.LATCHED:
            scale, clamped = self._follow(t_s, dt_s, wanted, bits)
            if clamped and self._too_many_clamps(t_s):
                self._hazards |= Hazard.FORCE_CLAMPED
                self._latch_due = True
                self._fade(t_s, FADE_S)
        return SupervisedForce(
            _read_only(self._sent), self._state, self._hazards, self._cause, scale, clamped
        )

    @property
    def rising(self) -> bool:
        """The force is on its way to the wanted one, at 6 N/s at most."""
        return self._slow

    def rearm(self, t_s: float) -> RearmAnswer:
        """An operator's request to leave LATCHED; nothing else may call this, least of all a network message.

        It is judged by what the last step saw and dropped if refused: it has to be repeated. A request that
        stayed pending would bring the force back seconds later, when the operator no longer expects it.

        Raises:
            InvalidInputError: time that goes back or is not finite.
        """
        age_s = self._elapsed_s(t_s, keep=False)
        if self._state is not SupervisorState.LATCHED:
            return RearmAnswer.NOT_LATCHED
        if age_s > REARM_AGE_S:
            return RearmAnswer.NO_RECENT_STEP
        if int(self._hazards) & self._fading:
            return RearmAnswer.HAZARD_ACTIVE
        if self._wanted_n >= REARM_BELOW_N:
            return RearmAnswer.FORCE_WANTED
        self._rise_s = REARM_RISE_S
        self._begin_rise(t_s)
        return RearmAnswer.ACCEPTED

    def _elapsed_s(self, t_s: float, *, keep: bool = True) -> float:
        """Time since the last step, 0 at the first."""
        last_s = self._t_s if self._t_s is not None else t_s
        if not (math.isfinite(t_s) and t_s >= last_s):
            raise InvalidInputError(
                f"time of the supervisor is {t_s:g} s after {last_s:g} s; it cannot go back"
            )
        if keep:
            self._t_s = t_s
        return t_s - last_s

    def _note_latching(self, t_s: float, bits: int) -> None:
        """Hazards that latch after 1 s share one clock: a tool lost, then frozen, is away throughout."""
        if bits & _LATCH_LATE:
            if self._unsafe_since_s is None:
                self._unsafe_since_s = t_s
            elif t_s - self._unsafe_since_s >= LATCH_AFTER_S:
                self._latch_due = True
        else:
            self._unsafe_since_s = None
        if bits & _LATCH_AT_ONCE:
            self._latch_due = True

    def _fade(self, t_s: float, duration_s: float) -> None:
        """Begin to release the sent force, unless a fade runs that ends as early."""
        if self._state is not SupervisorState.FADE or t_s + duration_s < self._fade_end_s:
            self._fade_from = self._sent
            self._fade_start_s = t_s
            self._fade_end_s = t_s + duration_s if any(self._sent) else t_s
            self._state = SupervisorState.FADE
        if int(self._hazards) & self._fading & ~int(self._cause):
            self._cause |= self._hazards & self._withholding

    def _release(self, t_s: float, bits: int) -> float:
        """The fade's share of the force at its beginning; after its end, where to go from here."""
        if t_s < self._fade_end_s:
            gone = (t_s - self._fade_start_s) / (self._fade_end_s - self._fade_start_s)
            scale = _falling_cosine(gone)
            x, y, z = self._fade_from
            self._sent = (scale * x, scale * y, scale * z)
            return scale
        self._sent = (0.0, 0.0, 0.0)
        if self._latch_due:
            self._state = SupervisorState.LATCHED
            self._clamps_s.clear()
        elif not bits & self._fading:
            self._begin_rise(t_s)
        return 0.0

    def _begin_rise(self, t_s: float) -> None:
        self._state = SupervisorState.DEGRADED
        self._cause = Hazard.NONE
        self._latch_due = False
        self._slow = True
        self._rise_start_s = t_s

    def _follow(
        self, t_s: float, dt_s: float, wanted: tuple[float, float, float], bits: int
    ) -> tuple[float, bool]:
        """Towards the wanted force; gives the rise's share of it, and whether a counted clamp was needed."""
        risen = (t_s - self._rise_start_s) / self._rise_s if self._rise_s > 0.0 else 1.0
        scale = 1.0 - _falling_cosine(min(max(risen, 0.0), 1.0)) if risen < 1.0 else 1.0
        slow = self._slow or bool(bits & _SLOW)
        largest_n = dt_s * (min(SLOW_SLEW_N_PER_S, self._slew_n_per_s) if slow else self._slew_n_per_s)
        sent = self._sent
        target = (scale * wanted[0], scale * wanted[1], scale * wanted[2])
        change = (target[0] - sent[0], target[1] - sent[1], target[2] - sent[2])
        size_n = math.hypot(*change)
        cut = size_n > largest_n
        share = largest_n / size_n if cut else 1.0
        if cut:
            target = (sent[0] + share * change[0], sent[1] + share * change[1], sent[2] + share * change[2])
        self._sent = target
        self._slow = slow and (cut or risen < 1.0)
        if not self._slow:
            self._rise_s = 0.0
        self._state = SupervisorState.DEGRADED if bits or self._slow else SupervisorState.OK
        return scale, cut and not slow and dt_s > 0.0

    def _too_many_clamps(self, t_s: float) -> bool:
        self._clamps_s.append(t_s)
        return len(self._clamps_s) == CLAMPS and t_s - self._clamps_s[0] <= CLAMPS_WITHIN_S


# plain integers: an IntFlag's operators cost as much as the rest of a step
_FAST = int(hazards_with(Response.FAST_FADE))
_AT_ONCE = int(hazards_with(Response.NO_FORCE))
_SLOW = int(hazards_with(Response.SLOW))
_LATCH_LATE = int(hazards_that_latch(Latch.AFTER_1_S))
_LATCH_AT_ONCE = int(hazards_that_latch(Latch.AT_ONCE))


def _falling_cosine(share: float) -> float:
    """Raised cosine from 1 to 0 as `share` goes from 0 to 1."""
    return 0.5 * (1.0 + math.cos(math.pi * share))


def _components(force_n: FloatArray) -> tuple[float, float, float]:
    try:
        x, y, z = force_n.tolist()
    except ValueError as exc:
        raise InvalidInputError(f"the wanted force has shape {force_n.shape}; needed (3,)") from exc
    return x, y, z


def _read_only(force: tuple[float, float, float]) -> FloatArray:
    array = np.array(force)
    array.setflags(write=False)
    return array
