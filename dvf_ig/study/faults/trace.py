"""Hazards and force over one trial, and what is judged of them: detection, force in error, recovery."""

from dataclasses import dataclass
from math import inf

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, IntArray, read_only_arrays
from dvf_ig.guidance import HAZARD_RULES, Hazard, Latch, Response, SupervisorState, withholding
from dvf_ig.guidance.supervision.supervisor import FADE_S, FAST_FADE_S, LATCH_AFTER_S, SLOW_SLEW_N_PER_S

NEAR_S = 0.05
"""What is found so little before a fault is found of it: noise takes the tip across a border too early."""
FORCE_N = 0.05
"""A longer force after it should have gone is given in error."""
POSE_OFF_MM = 2.5
"""A patient's motion is over for the force when the pose in use is this near again: two registrations of a
patient who lies still are (`registration_monitor.JUMP_MM`)."""
BACK_SHARE = 0.8
"""The force is back where it reaches this share of the wanted one."""

_FADE_S = {Response.NO_FORCE: 0.0, Response.FAST_FADE: FAST_FADE_S, Response.FADE: FADE_S}


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TrialTrace:
    """Steps of one trial.

    Attributes:
        t_s: (n,).
        hazards: (n,) bits that were active.
        state: (n,) SupervisorState values.
        sent_n, wanted_n: (n,) length of the force.
        pose_error_mm: (n,) of the pose in use, at the heart's centre.
    """

    t_s: FloatArray
    hazards: IntArray
    state: IntArray
    sent_n: FloatArray
    wanted_n: FloatArray
    pose_error_mm: FloatArray

    def has(self, hazards: Hazard) -> BoolArray:
        """(n,) whether any of these was active."""
        return np.asarray((self.hazards & int(hazards)) != 0)


@dataclass(frozen=True, slots=True)
class Judgement:
    """What became of one fault.

    Attributes:
        detected_s: from its begin to the first of the row's hazards; infinite never.
        found: the row's hazards that were raised.
        early: any hazard before the fault began, but for a pose that moves with the beats.
        error_n, error_s: largest force after it should have gone, and for how long above FORCE_N; None where
            the rule lets the force be.
        latched: the supervisor latched, and `latch_due`: it had to.
        recovery_s: from the end of the fault, or the re-arm, until the force was back; infinite never, None
            where it was never gone.
        slow: while the rule asks for it the force changed by no more than 6 N/s; None where it does not.
    """

    detected_s: float
    found: Hazard
    early: bool
    error_n: float | None
    error_s: float | None
    latched: bool
    latch_due: bool
    recovery_s: float | None
    slow: bool | None

    @property
    def recovered(self) -> bool:
        """The force came back, and in the way that the rule says."""
        returned = self.recovery_s is None or self.recovery_s < inf
        return returned and self.latched == self.latch_due and self.slow is not False


def judge(
    trace: TrialTrace,
    expected: Hazard,
    *,
    begin_s: float,
    end_s: float,
    limit_s: float,
    rearm_s: float,
    by_pose: bool = False,
) -> Judgement:
    """Judge a trial.

    Args:
        expected: hazards of the row, any of which detects it.
        begin_s, end_s: of the fault; limit_s: within which it must be detected.
        rearm_s: when the operator re-armed.
        by_pose: the force is wrong while the pose is off, whenever that is over.
    """
    t = trace.t_s
    during = (t >= begin_s) & trace.has(expected)
    first = int(np.argmax(during)) if during.any() else -1
    found = Hazard(int(np.bitwise_or.reduce(trace.hazards[during] & int(expected), initial=0)))
    before = trace.has(~Hazard.POSE_MOVING)[t < begin_s - NEAR_S].any()
    gone = _gone_within(trace, expected, first)
    error_n = error_s = None
    if found & withholding(walls=True):  # without a phase the wall stays
        wrong = (t > begin_s + limit_s + gone) & (t <= end_s)
        if by_pose:
            wrong &= trace.pose_error_mm > POSE_OFF_MM
        error_n = float(trace.sent_n[wrong].max(initial=0.0))
        error_s = _time(t, wrong & (trace.sent_n > FORCE_N))
    latched = bool((trace.state == SupervisorState.LATCHED).any())
    return Judgement(
        detected_s=float(t[first]) - begin_s if first >= 0 else inf,
        found=found,
        early=bool(before),
        error_n=error_n,
        error_s=error_s,
        latched=latched,
        latch_due=_latch_due(trace),
        recovery_s=_recovery_s(trace, begin_s, rearm_s if latched else end_s),
        slow=_slow(trace),
    )


def _gone_within(trace: TrialTrace, expected: Hazard, first: int) -> float:
    """The slowest fade of the hazards with which the fault was found."""
    at = Hazard(int(trace.hazards[first]) & int(expected)) if first >= 0 else Hazard.NONE
    return max((_FADE_S.get(HAZARD_RULES[h].response, 0.0) for h in at), default=0.0)


def _latch_due(trace: TrialTrace) -> bool:
    """What the rules of the hazards that were active ask for."""
    late = Hazard.NONE
    for hazard, rule in HAZARD_RULES.items():
        if rule.latch is Latch.AT_ONCE and trace.has(hazard).any():
            return True
        if rule.latch is Latch.AFTER_1_S:
            late |= hazard
    return _longest(trace.t_s, trace.has(late)) >= LATCH_AFTER_S


def _recovery_s(trace: TrialTrace, begin_s: float, from_s: float) -> float | None:
    """Until the force is what is wanted again, where it was not."""
    t, wanted = trace.t_s, trace.wanted_n
    given = trace.sent_n > BACK_SHARE * wanted
    lacking = (t >= begin_s) & ((trace.state >= SupervisorState.FADE) | ~given)
    if not lacking.any():
        return None
    last = int(np.flatnonzero(lacking)[-1])
    if last == len(t) - 1:
        return inf
    return max(0.0, float(t[last + 1]) - from_s)


def _slow(trace: TrialTrace) -> bool | None:
    """Force steps under a hazard with that response, against 6 N/s."""
    slowing = Hazard.NONE
    for hazard, rule in HAZARD_RULES.items():
        if rule.response is Response.SLOW:
            slowing |= hazard
    active = trace.has(slowing)[1:] & (trace.state[1:] == SupervisorState.DEGRADED)
    if not active.any():
        return None
    rate = np.abs(np.diff(trace.sent_n)) / np.diff(trace.t_s)
    return bool((rate[active] <= 1.01 * SLOW_SLEW_N_PER_S).all())


def _time(t_s: FloatArray, where: BoolArray) -> float:
    """Time in the steps marked; a step lasts until the next."""
    return float(np.diff(t_s)[where[:-1]].sum())


def _longest(t_s: FloatArray, where: BoolArray) -> float:
    """The longest stretch without a pause, s."""
    longest, since = 0.0, None
    for t, on in zip(t_s.tolist(), where.tolist(), strict=True):
        since = (t if since is None else since) if on else None
        longest = max(longest, t - since if since is not None else 0.0)
    return longest
