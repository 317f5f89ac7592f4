"""A live session held against a replay of the same recording: registrations, states, pose and force."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, IntArray, ScenarioTruth, read_only_arrays
from dvf_ig.guidance import Status, SupervisorState
from dvf_ig.replay import Replay
from dvf_ig.replay.result.score import pose_errors_mm
from dvf_ig.session import Attempt

from .asked import asked_at
from .run import LiveRun

LATE_S = 0.001
"""A pose of the tool that the replay has had for longer, and the live session not yet, was late."""
LARGEST_SHIFT_S, SHIFT_STEP_S = 0.05, 0.0005
SETTLED_S = 1.0
"""A force that fades, rises or is limited on either side is not compared until so long after."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class LiveSamples:
    """The answers of a live session as arrays, by the recording's clock.

    Attributes:
        state_s: (n,) times of the states; servo_s: of the servo's ticks.
        force_n: (n, 3) the servo's; session_n: (n, 3) the session's.
        servo, supervisor, status: (n,) codes.
        mr_from_tracker: (n, 3, 4) NaN where none was in use.
        tool_age_s: (n,) of the newest pose of the tool that had come.
    """

    state_s: FloatArray
    servo_s: FloatArray
    force_n: FloatArray
    session_n: FloatArray
    servo: IntArray
    supervisor: IntArray
    status: IntArray
    mr_from_tracker: FloatArray
    tool_age_s: FloatArray

    def __len__(self) -> int:
        return len(self.state_s)


def samples_of(run: LiveRun) -> LiveSamples:
    """Of what a live session sent."""
    answers, poses = run.answers, np.full((len(run.answers), 3, 4), np.nan)
    for i, answer in enumerate(answers):
        transform, now_s = answer.state.transform, answer.state.now_s
        if transform.pose is not None and now_s < transform.pose_until_s:
            poses[i] = transform.pose.matrices(np.array([now_s]))[0]
    return LiveSamples(
        state_s=np.array([a.state.now_s for a in answers]) + run.offset_s,
        servo_s=np.array([a.state.now_s for a in answers]) + run.offset_s,
        force_n=np.array([a.state.force_n for a in answers]),
        session_n=np.array([a.state.force_n for a in answers]),
        servo=np.array([int(a.state.supervisor) for a in answers]),
        supervisor=np.array([int(a.state.supervisor) for a in answers]),
        status=np.array([int(a.state.status) for a in answers]),
        mr_from_tracker=poses,
        tool_age_s=np.array([a.state.tool.age_s for a in answers]),
    )


def comparison(live: LiveRun, replay: Replay, truth: ScenarioTruth | None) -> dict[str, Any]:
    """What differs, as JSON values."""
    samples, ticks = samples_of(live), replay.ticks
    here = (samples.state_s > ticks.t_s[0]) & (samples.state_s < ticks.t_s[-1])
    at = np.clip(np.searchsorted(ticks.t_s, samples.state_s), 0, len(ticks) - 1)
    same_status = (samples.status == ticks.status[at])[here]
    same_state = (samples.supervisor == ticks.supervisor[at])[here]
    given = here & _settled(samples.state_s, samples.supervisor) & _settled(ticks.t_s, ticks.supervisor)[at]
    given &= (samples.status == Status.OK) & (ticks.status[at] == Status.OK)
    sent = given & _settled(samples.state_s, samples.servo)
    result = {
        "registrations": _registrations(live, replay),
        "same_status_share": float(same_status.mean()),
        "same_supervisor_share": float(same_state.mean()),
        "force_session": _force_at_answers(samples, replay, given),
        "force_servo": _force(samples.servo_s[sent], samples.force_n[sent], replay),
        "latency_ms": live.result["latency_ms"],
        "live": live.result,
    }
    if truth is not None:
        result["tre_mm"] = _tre(samples, replay, truth, at, here)
    return result


def _registrations(live: LiveRun, replay: Replay) -> list[dict[str, Any]]:
    ours, theirs = list(live.history.attempts), list(replay.attempts)
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


def _attempt(attempt: Attempt | None, offset_s: float) -> dict[str, Any] | None:
    if attempt is None:
        return None
    asked_s, ready_s = attempt.asked_s + offset_s, attempt.ready_s + offset_s
    return {"asked_s": asked_s, "ready_s": ready_s, "usable": attempt.usable, "reason": attempt.reason}


def _settled(t_s: FloatArray, codes: IntArray) -> BoolArray:
    """(n,) the supervisor has neither faded nor latched for SETTLED_S."""
    bad = codes > SupervisorState.DEGRADED
    last = np.maximum.accumulate(np.where(bad, t_s, -np.inf))
    return np.asarray(t_s - last > SETTLED_S)


def _force_at_answers(samples: LiveSamples, replay: Replay, given: BoolArray) -> dict[str, Any]:
    """Errors of the session's force at the very moments, and how many a late pose of the tool explains."""
    asked = asked_at(replay.scenario, replay.setup, samples.state_s)
    given = given & (asked.status == Status.OK) & _settled(samples.state_s, asked.supervisor)
    error = np.linalg.norm(samples.session_n - asked.force_n, axis=1)
    late = samples.tool_age_s > asked.tool_age_s + LATE_S
    return {
        **_summary(error[given]),
        "pose_late": _summary(error[given & late]),
        "pose_in_time": _summary(error[given & ~late]),
    }


def _summary(error_n: FloatArray) -> dict[str, Any]:
    if not len(error_n):
        return {"answers": 0}
    return {
        "answers": len(error_n),
        "median_n": float(np.median(error_n)),
        "p95_n": float(np.percentile(error_n, 95)),
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
    live = pose_errors_mm(samples.mr_from_tracker, samples.state_s, truth).mean(axis=1)
    theirs = pose_errors_mm(replay.ticks.mr_from_tracker[at], samples.state_s, truth).mean(axis=1)
    both = here & np.isfinite(live) & np.isfinite(theirs)
    a, b = live[both], theirs[both]
    return {
        "live": {"median": float(np.median(a)), "mean": float(a.mean()), "p95": float(np.percentile(a, 95))},
        "replay": {
            "median": float(np.median(b)),
            "mean": float(b.mean()),
            "p95": float(np.percentile(b, 95)),
        },
        "apart": {
            "of_medians": float(np.median(a) - np.median(b)),
            "of_means": float(a.mean() - b.mean()),
            "median": float(np.median(np.abs(a - b))),
            "p95": float(np.percentile(np.abs(a - b), 95)),
            "max": float(np.abs(a - b).max()),
        },
    }


def after_cut(live: LiveRun, replay: Replay, cut_s: float) -> dict[str, Any]:
    """What the force did when the connection was cut, by the servo's states; seconds after the cut.

    Returns:
        `fading_s`: when the force began to fade; `back_s`: when the tool was known again; `phase_s`: when the
        phase was locked again, too; null where that did not happen. `latched`: whether it took an operator.
    """
    samples, recorded = samples_of(live), replay.scenario
    first_s = min(float(recorded.ecg.t_s[0]), float(recorded.ultrasound.t_s[0]))
    since_s = samples.servo_s - first_s - cut_s
    faded = samples.servo > SupervisorState.DEGRADED
    fading = _first(since_s, (since_s > 0.0) & faded)
    back = None if fading is None else _first(since_s, (since_s > fading) & ~faded)
    phase = None if back is None else _first(since_s, (since_s >= back) & (samples.status == Status.OK))
    until = np.inf if back is None else back
    latched = (since_s > 0.0) & (since_s < until) & (samples.servo == SupervisorState.LATCHED)
    return {
        "cut_s": cut_s,
        "fading_s": fading,
        "back_s": back,
        "phase_s": phase,
        "latched": bool(latched.any()),
        "connections": live.result["connections"],
    }


def _first(t_s: FloatArray, where: BoolArray) -> float | None:
    found = np.flatnonzero(where)
    return float(t_s[found[0]]) if len(found) else None
