"""One fault in the streams of a session: states every millisecond around it, and the operator who re-arms.

A trace of hazards and force is judged by the rules of the hazards: detection, force in error, recovery. The
same judgement serves faults at the servo.
"""

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from data_synth.seeds import child_rng
from dvf_ig.core import BoolArray, FloatArray, IntArray, InvalidInputError, read_only_arrays
from dvf_ig.guidance import HAZARD_RULES, Hazard, Latch, Response, SupervisorState, withholding
from dvf_ig.guidance.supervision.supervisor import FADE_S, FAST_FADE_S, LATCH_AFTER_S, SLOW_SLEW_N_PER_S
from dvf_ig.session import GuidanceState, Rearm, Session, SessionHistory
from dvf_ig.study.faults.injection import Fault, When
from dvf_ig.study.faults.streams import (
    CENTER,
    HOME,
    Coordinates,
    InterventionSpec,
    KnownUltrasound,
    Streams,
    TipPath,
    at_rest,
    circling,
    drawn_beats,
    drawn_ecg,
    drawn_streams,
    wall_setup,
)

NEAR_S = 0.05
"""A hazard raised this little before the fault counts: noise takes the tip across a border too early."""
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
    """Outcome of one fault.

    Attributes:
        detected_s: from its begin to the first of the row's hazards; infinite never.
        found: the row's hazards that were raised.
        early: any hazard before the fault began, but for a pose that moves with the beats.
        error_n, error_s: largest force after it should have gone, and for how long above FORCE_N; None if
            the rule lets the force be.
        latched: the supervisor latched, and `latch_due`: it had to.
        recovery_s: from the end of the fault, or the re-arm, until the force was back; infinite never, None
            if it was never gone.
        slow: while the rule asks for it the force changed by no more than 6 N/s; None if it does not.
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
    raised = Hazard(int(np.bitwise_or.reduce(trace.hazards[during] & int(expected), initial=0)))
    before = trace.has(~Hazard.POSE_MOVING)[t < begin_s - NEAR_S].any()
    gone = _gone_within(trace, expected, first)
    error_n = error_s = None
    if raised & withholding(walls=True):  # without a phase the wall stays
        wrong = (t > begin_s + limit_s + gone) & (t <= end_s)
        if by_pose:
            wrong &= trace.pose_error_mm > POSE_OFF_MM
        error_n = float(trace.sent_n[wrong].max(initial=0.0))
        error_s = _time(t, wrong & (trace.sent_n > FORCE_N))
    latched = bool((trace.state == SupervisorState.LATCHED).any())
    return Judgement(
        detected_s=float(t[first]) - begin_s if first >= 0 else inf,
        found=raised,
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
    """Change that the rules of the active hazards ask for."""
    late = Hazard.NONE
    for hazard, rule in HAZARD_RULES.items():
        if rule.latch is Latch.AT_ONCE and trace.has(hazard).any():
            return True
        if rule.latch is Latch.AFTER_1_S:
            late |= hazard
    return _longest(trace.t_s, trace.has(late)) >= LATCH_AFTER_S


def _recovery_s(trace: TrialTrace, begin_s: float, from_s: float) -> float | None:
    """Time until the force is back at its expected value, if it was not."""
    t, expected_n = trace.t_s, trace.wanted_n
    restored = trace.sent_n > BACK_SHARE * expected_n
    lacking = (t >= begin_s) & ((trace.state >= SupervisorState.FADE) | ~restored)
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


BEGIN_S = 15.0
"""The pose is in use from about 13 s on; the fault begins within a second from here on."""
BEFORE_REGISTRATION_S = 1.0
"""The session asks for its second registration 16 s after its start at the latest."""
WARM_UP_STEP_S, STEP_S, AFTER_STEP_S = 0.02, 0.001, 0.01
AFTER_S = 0.5
"""Steps are short from AFTER_S before the fault until as long after it."""
OUT_MM = -10.0
"""Where the operator holds the tool to re-arm: the wall wants no force there."""
REARM_AFTER_S = 1.0
"""After the tool has been drawn back; it is back at the wall as long afterwards."""


@dataclass(frozen=True, slots=True)
class SessionFault:
    """One fault of the streams.

    Attributes:
        fault: what it does.
        seconds: how long.
        comes_back_s: the operator waits so long for the force before drawing the tool back to re-arm.
        step_s: of the states during the fault.
        on_registration: the fault begins when the registration of its frames is taken. It is put in
            BEFORE_REGISTRATION_S earlier, before the session asks for one.
        from_start: it is there from the first sample on.
        by_pose: the force is wrong while the pose is off, whenever that is over.
    """

    fault: Fault
    seconds: float
    comes_back_s: float = 1.5
    step_s: float = STEP_S
    on_registration: bool = False
    from_start: bool = False
    by_pose: bool = False


@dataclass(frozen=True, slots=True)
class FaultRun:
    """A trial's trace, of a session or of a servo.

    Attributes:
        begin_s, end_s: of the fault; rearm_s: when the operator asked for force.
    """

    trace: TrialTrace
    begin_s: float
    end_s: float
    rearm_s: float


def run_session_fault(planned: SessionFault, seed: int) -> FaultRun:
    """Put a fault into an intervention and run it."""
    begin_s = 0.0 if planned.from_start else BEGIN_S + float(child_rng(seed, "begin").uniform())
    begin_s -= BEFORE_REGISTRATION_S if planned.on_registration else 0.0
    when = When(begin_s, begin_s + planned.seconds)
    out_s = when.end_s + planned.comes_back_s
    rearm_s = out_s + REARM_AFTER_S
    until_s = rearm_s + 2.0 * REARM_AFTER_S
    streams, when = _streams(planned.fault, when, out_s, rearm_s, until_s, seed)
    fault, rng = planned.fault, child_rng(seed, "patient")
    patient = fault.patient(when, rng) if fault.patient is not None else at_rest
    registered = fault.registered(when, rng) if fault.registered is not None else at_rest
    history = SessionHistory()
    with Session(
        wall_setup(),
        history=history,
        ultrasound=lambda buffer: KnownUltrasound(buffer, patient, child_rng(seed, "beats"), registered),
    ) as session:
        times = _times(when, until_s, WARM_UP_STEP_S if planned.from_start else planned.step_s)
        trace = _run(session, streams, patient, times, (when.begin_s, rearm_s))
    if planned.on_registration:
        registered_s = [a.ready_s for a in history.registrations if when.begin_s <= a.asked_s < when.end_s]
        if not registered_s:
            raise InvalidInputError("no registration was asked for while the fault lasted; give it longer")
        when = replace(when, begin_s=registered_s[0])
    return FaultRun(trace, when.begin_s, when.end_s, rearm_s)


def _streams(
    fault: Fault, when: When, out_s: float, rearm_s: float, until_s: float, seed: int
) -> tuple[Streams, When]:
    """Streams with the fault, and when it really begins."""
    path = fault.tip(when) if fault.tip is not None else circling
    spec = InterventionSpec(until_s + 0.5, tip=_drawn_back(path, out_s, rearm_s))
    beats, rng = drawn_beats(spec, seed), child_rng(seed, "fault")
    if fault.beats is not None:
        beats, when = fault.beats(beats, when, rng)
    samples = drawn_ecg(spec, beats, seed)
    if fault.samples is not None:
        samples = fault.samples(samples, when, rng)
    streams = drawn_streams(spec, samples, seed)
    if fault.tool is not None:
        streams.tool = fault.tool(streams.tool, when)
    if fault.frames is not None:
        streams.frames = fault.frames(streams.frames, when)
    if fault.ecg is not None:
        streams.ecg = fault.ecg(streams.ecg, when)
    return streams, when


def _drawn_back(path: TipPath, out_s: float, rearm_s: float) -> TipPath:
    """The tool leaves the wall, and comes back REARM_AFTER_S after the re-arm."""
    knots_s = [out_s, out_s + 0.5, rearm_s + REARM_AFTER_S - 0.5, rearm_s + REARM_AFTER_S]

    def tip(t_s: FloatArray) -> FloatArray:
        at = path(t_s)
        share = np.interp(t_s, knots_s, [0.0, 1.0, 1.0, 0.0])
        at[:, 0] += share * (OUT_MM - at[:, 0])
        return at

    return tip


def _times(when: When, until_s: float, step_s: float) -> list[float]:
    around = when.begin_s - AFTER_S, when.end_s + AFTER_S
    parts = (
        np.arange(WARM_UP_STEP_S, around[0], WARM_UP_STEP_S),
        np.arange(max(WARM_UP_STEP_S, around[0]), around[1], step_s),
        np.arange(around[1], until_s, max(step_s, AFTER_STEP_S)),
    )
    times: list[float] = np.unique(np.round(np.concatenate(parts), 6)).tolist()
    return times


def _run(
    session: Session,
    streams: Streams,
    patient: Coordinates,
    times: list[float],
    begin_and_rearm_s: tuple[float, float],
) -> TrialTrace:
    """States at all times; the trace begins a moment before the fault."""
    begin_s, rearm_s = begin_and_rearm_s
    arrivals = streams.merged()
    rows, pushed, rearmed = [], 0, False
    for now_s in times:
        while pushed < len(arrivals) and arrivals[pushed][0] <= now_s:
            session.push(arrivals[pushed][1], arrivals[pushed][0])
            pushed += 1
        if now_s >= rearm_s and not rearmed:
            session.push(Rearm(now_s))
            rearmed = True
        state = session.state(now_s)
        if now_s >= begin_s - AFTER_S:
            sent = state.supervised
            rows.append(
                (
                    now_s,
                    int(sent.hazards),
                    int(sent.state),
                    float(np.linalg.norm(sent.force_n)),
                    float(np.linalg.norm(state.wanted_n)),
                    _pose_error_mm(state, patient),
                )
            )
    t_s, hazards, states, sent_n, wanted_n, off_mm = (np.array(column) for column in zip(*rows, strict=True))
    return TrialTrace(t_s, hazards.astype(np.int64), states.astype(np.int64), sent_n, wanted_n, off_mm)


def _pose_error_mm(state: GuidanceState, patient: Coordinates) -> float:
    """Error of the pose in use at the heart's centre; 0 without a pose."""
    if state.transform.pose is None:
        return 0.0
    there = patient(state.now_s)[3:]
    if state.now_s >= state.transform.pose.end_s:
        pose = state.transform.pose.end
    else:
        pose = state.transform.pose.at(state.now_s)
    return float(np.linalg.norm(pose.apply_array(_CENTER_TRACKER) - CENTER - there))


_CENTER_TRACKER = HOME.inverse().apply_array(CENTER)
