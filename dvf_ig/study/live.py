"""Stream a scenario over loopback at real speed to a live session, replay it, and state what differs.

Registrations, states, error at the targets, force after the latency is taken off, and the latency from a tool
pose's arrival to the force's departure. Takes the recording's length and a replay; other work on the machine
shows in the live session.

    dvf-ig study live demo -o study
"""

import multiprocessing
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import InvalidInputError, Landmarks, Scenario, ScenarioTruth
from dvf_ig.core.arrays import BoolArray, FloatArray, IntArray, read_only_arrays
from dvf_ig.guidance import Status, SupervisorState
from dvf_ig.intake import cached_model, read_scenario
from dvf_ig.intake.live import EcgFieldConfig, LiveConfig
from dvf_ig.intake.start import landmarks_start
from dvf_ig.live.igtl import Message, Transform, encode
from dvf_ig.live.link import Link, listen
from dvf_ig.live.loop import Answer
from dvf_ig.live.player import play
from dvf_ig.live.serve import LiveOptions, SessionThread, live_session
from dvf_ig.live.summary import LiveSummary
from dvf_ig.replay import Replay, events_of, run_replay
from dvf_ig.replay.engine import SimulatedOperator
from dvf_ig.replay.result.score import pose_errors_mm
from dvf_ig.session import EcgSource, GuidanceState, RegistrationRecord, Session, SessionHistory, SessionSetup

from .driver import Driver, Result, Rows, Study
from .options import option


@dataclass(frozen=True, kw_only=True)
class LiveSettings:
    """Options of the study."""

    scenario: Path = option("Scenario folder (see `dvf-ig synth scenario`).", argument=True)
    cut: float | None = option(
        "Cut the connection after this many seconds, within a message.", None, least=1.0
    )
    seed: int = option("Seed of every random choice.", 0)


ORIGIN_S = 1.0e6
"""Stamps are those of the recording and this: float64 then resolves a ten-thousandth of a microsecond."""
SETTLE_S = 1.0
"""The session goes on for so long after the last message."""
CONNECT_WITHIN_S = 30.0


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class LiveSamples:
    """States of a session as arrays.

    Attributes:
        t_s: (n,) times of the states, by the recording's clock.
        force_n: (n, 3) in frame "tracker".
        supervisor, status: (n,) codes.
        mr_from_tracker: (n, 3, 4) NaN if none was in use.
        tool_age_s: (n,) of the newest pose of the tool that had come.
    """

    t_s: FloatArray
    force_n: FloatArray
    supervisor: IntArray
    status: IntArray
    mr_from_tracker: FloatArray
    tool_age_s: FloatArray


def samples_of(states: Sequence[GuidanceState], offset_s: float = 0.0) -> LiveSamples:
    """Gather states; `offset_s` is the recording's time less that of their clock."""
    poses = np.full((len(states), 3, 4), np.nan)
    for i, state in enumerate(states):
        if state.transform.pose is not None and state.now_s < state.transform.pose_until_s:
            poses[i] = state.transform.pose.matrices(np.array([state.now_s]))[0]
    return LiveSamples(
        t_s=np.array([state.now_s for state in states]) + offset_s,
        force_n=np.array([state.force_n for state in states]).reshape(-1, 3),
        supervisor=np.array([int(state.supervisor) for state in states], dtype=np.int64),
        status=np.array([int(state.status) for state in states], dtype=np.int64),
        mr_from_tracker=poses,
        tool_age_s=np.array([state.tool.age_s for state in states]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class LiveRun:
    """Run of a live session on a recording.

    Attributes:
        answers: in order.
        history: of the session, by its clock.
        offset_s: recording's time less the session's.
        result: of `LiveSummary`.
    """

    answers: tuple[Answer, ...]
    history: SessionHistory
    offset_s: float
    result: dict[str, Any]

    @property
    def samples(self) -> LiveSamples:
        return samples_of([answer.state for answer in self.answers], self.offset_s)


def run_live(
    folder: Path,
    setup: SessionSetup,
    landmarks: tuple[Landmarks, Landmarks] | None,
    cut_s: float | None = None,
) -> LiveRun:
    """Stream a scenario folder to a live session on this machine.

    Args:
        setup, landmarks: as a replay of it has them.
        cut_s: so long after the beginning the other process sends half a message and closes the connection.
    Raises:
        InvalidInputError: beats from a trigger, or a stream that did not begin.
    """
    if not isinstance(setup.beat_source, EcgSource):
        raise InvalidInputError("a live session is compared on an ECG; this recording has a trigger")
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    child = context.Process(target=stream_folder, args=(folder, cut_s, theirs), daemon=True)
    child.start()
    try:
        if not ours.poll(CONNECT_WITHIN_S):
            raise InvalidInputError(f"{folder} could not be streamed within {CONNECT_WITHIN_S:g} s")
        config = LiveConfig(port=ours.recv(), ecg=EcgFieldConfig(rate_hz=setup.beat_source.rate_hz))
        return _taken(config, setup, landmarks, ours)
    finally:
        child.kill()
        child.join()


def stream_folder(folder: Path, cut_s: float | None, told: Connection) -> None:
    """In the other process: say the port, wait for a word, stream, and say that it is over."""
    scenario = read_scenario(folder, truth=False)
    with listen("127.0.0.1", 0, None) as link:
        told.send(link.port)
        told.recv()
        stop = threading.Event()
        while not link.peers:
            stop.wait(0.01)
        if cut_s is not None:
            threading.Timer(cut_s, _cut, (link,)).start()
        told.send(play(scenario, link, speed=1.0, origin_s=ORIGIN_S, stop=stop))
        told.recv()


def _cut(link: Link) -> None:
    """Half a message, and the end; the other side may connect again."""
    whole = encode(Message("ToolToTracker", 1.0, Transform(np.eye(4))))
    for peer in link.peers:
        peer.offer(whole[: len(whole) // 2])
        peer.close()


def _taken(
    config: LiveConfig, setup: SessionSetup, landmarks: tuple[Landmarks, Landmarks] | None, child: Connection
) -> LiveRun:
    answers: list[Answer] = []
    history, summary, operator = SessionHistory(), LiveSummary(), SimulatedOperator()

    def observe(answer: Answer) -> None:
        answers.append(answer)
        summary.add(answer)
        if operator.action(answer.state) is not None:
            loop.ask_rearm()

    options = LiveOptions(config, landmarks=landmarks, observe=observe, history=history)
    with live_session(setup, options) as loop:
        thread = SessionThread(loop)
        thread.start()
        child.send("begin")
        child.recv()
        thread.join(SETTLE_S)
        thread.end()
        result = summary.result(loop)
        child.send("end")
        return LiveRun(tuple(answers), history, loop.source.tool_offset_s - ORIGIN_S, result)


def asked_at(scenario: Scenario, setup: SessionSetup, t_s: FloatArray) -> LiveSamples:
    """States, at (n,) times in order by the recording's clock, of a session to which nothing comes late.

    Between two ticks of a replay a pose may have come: the force between them is that of neither.
    """
    events = events_of(scenario)
    upcoming = next(events)
    states = []
    with Session(setup) as session:
        for now_s in t_s.tolist():
            while upcoming[0] <= now_s:
                session.push(upcoming[1])
                upcoming = next(events, (np.inf, upcoming[1]))
            states.append(session.state(now_s))
    return samples_of(states)


LATE_S = 0.001
"""A pose of the tool that the replay has had for longer, and the live session not yet, was late."""
LARGEST_SHIFT_S, SHIFT_STEP_S = 0.05, 0.0005
SETTLED_S = 1.0
"""A force that fades, rises or is limited on either side is not compared until so long after."""


def comparison(live: LiveRun, replay: Replay, truth: ScenarioTruth | None) -> dict[str, Any]:
    """Compare a live session with a replay; JSON values."""
    samples, ticks = live.samples, replay.ticks
    here = (samples.t_s > ticks.t_s[0]) & (samples.t_s < ticks.t_s[-1])
    at = np.clip(np.searchsorted(ticks.t_s, samples.t_s), 0, len(ticks) - 1)
    same_status = (samples.status == ticks.status[at])[here]
    same_state = (samples.supervisor == ticks.supervisor[at])[here]
    comparable = here & _settled(samples.t_s, samples.supervisor) & _settled(ticks.t_s, ticks.supervisor)[at]
    comparable &= (samples.status == Status.OK) & (ticks.status[at] == Status.OK)
    result = {
        "registrations": _registrations(live, replay),
        "same_status_share": float(same_status.mean()),
        "same_supervisor_share": float(same_state.mean()),
        "force_session": _force_at_answers(samples, replay, comparable),
        "force_servo": _force(samples.t_s[comparable], samples.force_n[comparable], replay),
        "latency_ms": live.result["latency_ms"],
        "live": live.result,
    }
    if truth is not None:
        result["tre_mm"] = _tre(samples, replay, truth, at, here)
    return result


def _registrations(live: LiveRun, replay: Replay) -> list[dict[str, Any]]:
    ours, theirs = live.history.registrations, replay.attempts
    center = replay.heart.center_mm[None]
    rows = []
    for i in range(max(len(ours), len(theirs))):
        a, b = (one[i] if i < len(one) else None for one in (ours, theirs))
        row: dict[str, Any] = {
            "live": _attempt(a, live.offset_s),
            "replay": _attempt(b, 0.0),
            "apart_mm": None,
        }
        if a is not None and b is not None and a.result is not None and b.result is not None:
            poses = [
                one.result.target_from_source.inverse().apply_array(center) for one in (a, b) if one.result
            ]
            row["apart_mm"] = float(np.linalg.norm(poses[0] - poses[1]))
        rows.append(row)
    return rows


def _attempt(attempt: RegistrationRecord | None, offset_s: float) -> dict[str, Any] | None:
    if attempt is None:
        return None
    asked_s, ready_s = attempt.asked_s + offset_s, attempt.ready_s + offset_s
    return {"asked_s": asked_s, "ready_s": ready_s, "usable": attempt.usable, "reason": attempt.reason}


def _settled(t_s: FloatArray, codes: IntArray) -> BoolArray:
    """(n,) the supervisor has neither faded nor latched for SETTLED_S."""
    bad = codes > SupervisorState.DEGRADED
    last = np.maximum.accumulate(np.where(bad, t_s, -np.inf))
    return np.asarray(t_s - last > SETTLED_S)


def _force_at_answers(samples: LiveSamples, replay: Replay, comparable: BoolArray) -> dict[str, Any]:
    """Errors of the session's force at the very moments, and how many a late pose of the tool explains."""
    states = asked_at(replay.scenario, replay.setup, samples.t_s)
    comparable = comparable & (states.status == Status.OK) & _settled(samples.t_s, states.supervisor)
    error = np.linalg.norm(samples.force_n - states.force_n, axis=1)
    late = samples.tool_age_s > states.tool_age_s + LATE_S
    return {
        **_summary(error[comparable]),
        "pose_late": _summary(error[comparable & late]),
        "pose_in_time": _summary(error[comparable & ~late]),
    }


def _summary(error_n: FloatArray) -> dict[str, Any]:
    if not len(error_n):
        return {"answers": 0}
    return {
        "answers": len(error_n),
        "median_n": float(np.median(error_n)),
        "p95_n": _p95(error_n),
        "p99_n": float(np.percentile(error_n, 99)),
        "max_n": float(error_n.max()),
        "within_0.02_share": float((error_n <= 0.02).mean()),
    }


def _force(t_s: FloatArray, force_n: FloatArray, replay: Replay) -> dict[str, Any]:
    """Errors at the shift of time that makes their median least."""
    if not len(t_s):
        return {"answers": 0}
    ticks = replay.ticks
    shifts = np.arange(0.0, LARGEST_SHIFT_S + SHIFT_STEP_S / 2, SHIFT_STEP_S)
    errors = [_apart(t_s - shift, force_n, ticks.t_s, ticks.force_n) for shift in shifts]
    best = int(np.argmin([error.mean() for error in errors]))
    error = errors[best]
    return {**_summary(error), "shift_ms": 1e3 * float(shifts[best])}


def _apart(t_s: FloatArray, force_n: FloatArray, at_s: FloatArray, of_n: FloatArray) -> FloatArray:
    there = np.column_stack([np.interp(t_s, at_s, of_n[:, k]) for k in range(3)])
    return np.asarray(np.linalg.norm(force_n - there, axis=1))


def _tre(
    samples: LiveSamples, replay: Replay, truth: ScenarioTruth, at: IntArray, here: BoolArray
) -> dict[str, Any]:
    """Mean error at the targets over answers at which both had a pose."""
    live = pose_errors_mm(samples.mr_from_tracker, samples.t_s, truth).mean(axis=1)
    theirs = pose_errors_mm(replay.ticks.mr_from_tracker[at], samples.t_s, truth).mean(axis=1)
    both = here & np.isfinite(live) & np.isfinite(theirs)
    a, b = live[both], theirs[both]
    return {
        "live": {"median": float(np.median(a)), "mean": float(a.mean()), "p95": _p95(a)},
        "replay": {"median": float(np.median(b)), "mean": float(b.mean()), "p95": _p95(b)},
        "apart": {
            "of_medians": float(np.median(a) - np.median(b)),
            "of_means": float(a.mean() - b.mean()),
            "median": float(np.median(np.abs(a - b))),
            "p95": _p95(np.abs(a - b)),
            "max": float(np.abs(a - b).max()),
        },
    }


def _p95(values: FloatArray) -> float:
    return float(np.percentile(values, 95))


def after_cut(live: LiveRun, replay: Replay, cut_s: float) -> dict[str, Any]:
    """Follow the force after the connection was cut, by the servo's states; seconds after the cut.

    Returns:
        `fading_s`: when the force began to fade; `back_s`: when the tool was known again; `phase_s`: when the
        phase was also locked again; null if that did not happen. `latched`: whether it took an operator.
    """
    samples, recorded = live.samples, replay.scenario
    first_s = min(float(recorded.ecg.t_s[0]), float(recorded.ultrasound.t_s[0]))
    since_s = samples.t_s - first_s - cut_s
    faded = samples.supervisor > SupervisorState.DEGRADED
    fading = _first(since_s, (since_s > 0.0) & faded)
    back = None if fading is None else _first(since_s, (since_s > fading) & ~faded)
    phase = None if back is None else _first(since_s, (since_s >= back) & (samples.status == Status.OK))
    until = np.inf if back is None else back
    latched = (since_s > 0.0) & (since_s < until) & (samples.supervisor == SupervisorState.LATCHED)
    return {
        "cut_s": cut_s,
        "fading_s": fading,
        "back_s": back,
        "phase_s": phase,
        "latched": bool(latched.any()),
        "connections": live.result["connections"],
    }


def _first(t_s: FloatArray, where: BoolArray) -> float | None:
    indices = np.flatnonzero(where)
    return float(t_s[indices[0]]) if len(indices) else None


def run(settings: LiveSettings, driver: Driver) -> Result:
    """Replay the scenario, then stream it to a live session."""
    recorded = read_scenario(settings.scenario)
    with driver.progress("replay") as report:
        model = cached_model(recorded.preop).model
        replayed = run_replay(recorded, model=model, seed=settings.seed, progress=report)
    landmarks = None
    if landmarks_start(recorded) and recorded.landmarks_mr and recorded.landmarks_tracker:
        landmarks = (recorded.landmarks_mr, recorded.landmarks_tracker)
    streamed = run_live(settings.scenario, replayed.setup, landmarks, settings.cut)
    fields = comparison(streamed, replayed, recorded.truth)
    if settings.cut is not None:
        fields["cut"] = after_cut(streamed, replayed, settings.cut)
    return Result(fields, _table(fields), {"live.json": fields})


def _table(result: dict[str, Any]) -> Rows:
    latency = result["latency_ms"]
    rows: Rows = [
        ("latency, pose in to force out", "median {median:.2f} ms, p99 {p99:.2f} ms".format(**latency)),
        ("same status", f"{100 * result['same_status_share']:.1f} % of answers"),
        ("same supervisor state", f"{100 * result['same_supervisor_share']:.1f} % of answers"),
    ]
    for name, what in (("force_session", "session's force"), ("force_servo", "servo's force")):
        force = result[name]
        if force["answers"]:
            line = "apart by median {median_n:.4f} N, p95 {p95_n:.4f}, max {max_n:.3f}".format(**force)
            after = "after {shift_ms:.1f} ms".format(**force) if "shift_ms" in force else ""
            rows.append((what, line, after))
    for key, what in (("pose_in_time", "tool's pose in time"), ("pose_late", "tool's pose late")):
        force = result["force_session"].get(key, {"answers": 0})
        if force["answers"]:
            line = "{answers} answers, p95 {p95_n:.4f} N, max {max_n:.3f}".format(**force)
            rows.append((f"session's force, {what}", line))
    if "tre_mm" in result:
        tre = result["tre_mm"]
        means = f"live {tre['live']['mean']:.3f} mm, replay {tre['replay']['mean']:.3f} mm"
        rows.append(("mean error at the targets", means))
    if "cut" in result:
        cut = result["cut"]
        times = ", ".join(
            f"{what} after {cut[key]:.2f} s"
            for key, what in (("fading_s", "fades"), ("back_s", "comes back"), ("phase_s", "with its phase"))
            if cut[key] is not None
        )
        rows.append(
            (f"force after the cut at {cut['cut_s']:g} s", times, "re-armed" if cut["latched"] else "")
        )
    for number, row in enumerate(result["registrations"], start=1):
        both = " / ".join(
            "none" if one is None else f"asked {one['asked_s']:.2f} s, known {one['ready_s']:.2f} s"
            for one in (row["live"], row["replay"])
        )
        apart = "" if row["apart_mm"] is None else f"{row['apart_mm']:.3f} mm apart"
        rows.append((f"registration {number}, live / replay", both, apart))
    return rows


STUDY = Study(
    LiveSettings,
    run,
    outputs=lambda _: ("live.json",),
    trials=False,
    needs_folder=False,
    threads=True,
    lists_inputs=True,
)
