"""One fault in the streams of a session: states every millisecond around it, and the operator who re-arms."""

from dataclasses import dataclass, replace

import numpy as np

from data_synth.seeds import child_rng
from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.session import GuidanceState, Rearm, Session, SessionHistory

from .injection.fault import Fault, When
from .known_ultrasound import Coordinates, KnownUltrasound, at_rest
from .patient import CENTER, HOME, wall_setup
from .streams import (
    InterventionSpec,
    Streams,
    TipPath,
    circling,
    drawn_beats,
    drawn_ecg,
    drawn_streams,
)
from .trace import TrialTrace

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
class SessionRun:
    """A trial's trace.

    Attributes:
        begin_s, end_s: of the fault; rearm_s: when the operator asked for force.
    """

    trace: TrialTrace
    begin_s: float
    end_s: float
    rearm_s: float


def run_session_fault(given: SessionFault, seed: int) -> SessionRun:
    """Put a fault into an intervention and run it."""
    begin_s = 0.0 if given.from_start else BEGIN_S + float(child_rng(seed, "begin").uniform())
    begin_s -= BEFORE_REGISTRATION_S if given.on_registration else 0.0
    when = When(begin_s, begin_s + given.seconds)
    out_s = when.end_s + given.comes_back_s
    rearm_s = out_s + REARM_AFTER_S
    until_s = rearm_s + 2.0 * REARM_AFTER_S
    streams, when = _streams(given.fault, when, out_s, rearm_s, until_s, seed)
    fault, rng = given.fault, child_rng(seed, "patient")
    patient = fault.patient(when, rng) if fault.patient is not None else at_rest
    registered = fault.registered(when, rng) if fault.registered is not None else at_rest
    history = SessionHistory()
    with Session(
        wall_setup(),
        history=history,
        ultrasound=lambda buffer: KnownUltrasound(buffer, patient, child_rng(seed, "beats"), registered),
    ) as session:
        times = _times(when, until_s, WARM_UP_STEP_S if given.from_start else given.step_s)
        trace = _run(session, streams, patient, times, (when.begin_s, rearm_s))
    if given.on_registration:
        taken = [a.ready_s for a in history.attempts if when.begin_s <= a.asked_s < when.end_s]
        if not taken:
            raise InvalidInputError("no registration was asked for while the fault lasted; give it longer")
        when = replace(when, begin_s=taken[0])
    return SessionRun(trace, when.begin_s, when.end_s, rearm_s)


def _streams(
    fault: Fault, when: When, out_s: float, rearm_s: float, until_s: float, seed: int
) -> tuple[Streams, When]:
    """What arrives, and when the fault really begins."""
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
    """Of the pose in use at the heart's centre; 0 without one."""
    if state.transform.pose is None:
        return 0.0
    there = patient(state.now_s)[3:]
    if state.now_s >= state.transform.pose.end_s:
        pose = state.transform.pose.end
    else:
        pose = state.transform.pose.at(state.now_s)
    return float(np.linalg.norm(pose.apply_array(_CENTER_TRACKER) - CENTER - there))


_CENTER_TRACKER = HOME.inverse().apply_array(CENTER)
