"""Topics of a session's log and their messages: the exact inputs, and the answers."""

import numpy as np

from dvf_ig.core.arrays import FloatArray
from dvf_ig.guidance import Hazard, Status, SupervisorState
from dvf_ig.io.ros import messages as ros

DOCUMENT = "session.json"
ECG, IMAGE, TRIGGER = "/ecg", "/ultrasound/image", "/trigger"
EXACT_FRAME, EXACT_TOOL, RESPIRATION = "/exact/ultrasound", "/exact/tool", "/exact/respiration"
STREAMS = {
    ECG: ros.ARRAY,
    TRIGGER: ros.ARRAY,
    IMAGE: ros.IMAGE,
    EXACT_FRAME: ros.ARRAY,
    EXACT_TOOL: ros.ARRAY,
    RESPIRATION: ros.ARRAY,
}
"""Topics that a replay reads, with the type of each."""
POSE_LABEL = "t_s, valid, rotation (9, row-major), translation_mm (3): tracker_from_{}"
IMAGE_LABEL = ", then whether the image is valid"
LEVELS = {
    SupervisorState.OK: 0,
    SupervisorState.DEGRADED: 1,
    SupervisorState.FADE: 2,
    SupervisorState.LATCHED: 2,
}
"""Levels of diagnostics: OK, warning, error."""
GUIDANCE = (
    *("phi", "model_phase", "rr_s", "distance_mm", "pose_age_s"),
    *("breath_phase", "breath_mm", "breath_state"),
)
"""Columns of ticks.csv that are logged as numbers; NaN for missing values, `BreathState` or -1."""
STATUS_EVERY_S = 1.0


def exact_pose(t_s: float, valid: bool, rotation: FloatArray, translation_mm: FloatArray) -> FloatArray:
    return np.concatenate([[t_s, float(valid)], rotation.ravel(), translation_mm])


def status_message(t_s: float, status: int, supervisor: int, hazards: int) -> ros.Message:
    state = SupervisorState(supervisor)
    active = "|".join(one.name.lower() for one in Hazard(hazards) if one.name)
    values = {"status": Status(status).name.lower(), "hazards": active}
    return ros.diagnostics(t_s, LEVELS[state], "supervisor", state.name.lower(), values)
