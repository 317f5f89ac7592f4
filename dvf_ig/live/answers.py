"""Answers to the peers: pose, force and state of the session, as OpenIGTLink messages.

    MrFromTracker   TRANSFORM   p_ras = M p_tracker: the tracker's coordinates as they came, to the MR in RAS
    ToolForce       TRANSFORM   translation: the force on the tool, N, along the axes in which poses came
    DvfIg           STATUS      OK, or why no force is given
    DvfIgState      STRING      the same with numbers, JSON

The pose is what 3D Slicer shows (transform to parent); it is not sent while none may be used.
"""

import json
import math
from typing import Any

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.guidance import SupervisorState
from dvf_ig.guidance.servo import SentForce
from dvf_ig.session import GuidanceState

from .igtl import Message, Status, StatusCode, Text, Transform

POSE_NAME, FORCE_NAME, STATUS_NAME, STATE_NAME = "MrFromTracker", "ToolForce", "DvfIg", "DvfIgState"
RAS_FROM_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])

_CODES = {
    SupervisorState.OK: StatusCode.OK,
    SupervisorState.DEGRADED: StatusCode.OK,
    SupervisorState.FADE: StatusCode.NOT_READY,
    SupervisorState.LATCHED: StatusCode.DISABLED,
}


def pose_matrix(state: GuidanceState) -> FloatArray | None:
    """(4, 4) mr_from_tracker now, LPS; None if no pose may be used."""
    pose = state.transform.pose
    if pose is None or state.now_s >= state.transform.pose_until_s:
        return None
    matrix = np.eye(4)
    matrix[:3] = pose.matrices(np.array([state.now_s]))[0]
    return matrix


def pose_message(state: GuidanceState, stamp_s: float) -> tuple[Message, ...]:
    """MrFromTracker; nothing where no pose may be used."""
    matrix = pose_matrix(state)
    if matrix is None:
        return ()
    return (Message(POSE_NAME, stamp_s, Transform(RAS_FROM_LPS @ matrix)),)


def force_message(force_n: FloatArray, stamp_s: float | None) -> Message:
    """ToolForce.

    Args:
        force_n: (3,) frame "tracker".
    """
    matrix = np.eye(4)
    matrix[:3, 3] = force_n
    return Message(FORCE_NAME, stamp_s, Transform(matrix))


def state_messages(
    state: GuidanceState, stamp_s: float, *problems: str | None, sent: SentForce | None = None
) -> tuple[Message, ...]:
    """STATUS and STRING.

    Args:
        sent: force of a haptic device's own servo, whose state and reasons count then.
        problems: what else is wrong, a sentence each: with the session's record, with who sends the tool.
    """
    supervisor, numbers = state.supervisor, state_numbers(state)
    if sent is not None:
        supervisor = sent.state
        numbers["supervisor"] = numbers["servo"] = supervisor.name
        numbers["reasons"] = [*sent.hazards.sentences, *state.registration_reasons]
    numbers["reasons"] += [problem for problem in problems if problem is not None]
    text = json.dumps(numbers, allow_nan=False)
    status = Status(
        _CODES[supervisor], int(supervisor), supervisor.name, "; ".join(numbers["reasons"])[:1000]
    )
    return Message(STATUS_NAME, stamp_s, status), Message(STATE_NAME, stamp_s, Text(text))


def last_messages(sentence: str, stamp_s: float | None) -> tuple[Message, ...]:
    """No force, and why there will be none any more."""
    latched = SupervisorState.LATCHED
    status = Status(StatusCode.DISABLED, int(latched), latched.name, sentence)
    text = json.dumps({"supervisor": latched.name, "servo": latched.name, "reasons": [sentence]})
    force = force_message(np.zeros(3), stamp_s)
    return force, Message(STATUS_NAME, stamp_s, status), Message(STATE_NAME, stamp_s, Text(text))


def state_numbers(state: GuidanceState) -> dict[str, Any]:
    """The state as JSON values; what is not known is null."""
    phase = state.phase
    return {
        "t_s": state.now_s,
        "supervisor": state.supervisor.name,
        "servo": state.supervisor.name,
        "status": state.status.name,
        "reasons": list(state.reasons),
        "phase": _known(phase.phi),
        "phase_sigma": _known(phase.sigma_phi),
        "phase_state": phase.state.name,
        "rr_s": _known(phase.rr_s),
        "model_phase": _known(state.model_phase),
        "pose_age_s": _known(state.pose_age_s),
        "pose_bound_mm": _known(state.pose_bound_mm),
        "distance_mm": _known(state.distance_mm),
        "margin_mm": _known(float(state.margin_mm[0])),
        "tool_age_s": _known(state.tool.age_s),
    }


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
