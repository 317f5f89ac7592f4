"""Convert one state of a running session to a live event: the columns of a tick by their names."""

from __future__ import annotations

from typing import Any

import numpy as np

from dvf_ig.core import FloatArray, PhaseState
from dvf_ig.guidance import Hazard, Tool
from dvf_ig.guidance.servo import SentForce
from dvf_ig.session import GuidanceState

from .series import FORCE_MR, FORCE_TRACKER, SHAFT, STEPS, TIP

_DECIMALS = {name: max(0, round(-np.log10(step))) for name, step in STEPS.items()}


def state_event(state: GuidanceState, tool: Tool, sent: SentForce | None = None) -> dict[str, Any]:
    """Build the fields that every live event has (`dvf_ig/report/web/README.md`).

    The caller adds new data: `ecg`, `r_peaks_s`, `frame` (see `frame_event`) and `marks`.

    Args:
        tool: on which the fixtures act.
        sent: force of a haptic device's own servo, which is shown then.
    """
    now_s, phase, transform = state.now_s, state.phase, state.transform
    force_n = state.force_n if sent is None else sent.force_n
    tip, shaft, force_mr = (np.full(3, np.nan) for _ in range(3))
    if transform.pose is not None and now_s < transform.pose_until_s:
        pose = transform.pose.at(now_s)
        force_mr = pose.rotation @ force_n
        if not state.tool.hazard:
            tip = pose.apply_array(state.tool.tip_tracker_mm)
            tip_mm, turn = state.calibrations.tip.xyz_mm[0], state.tool.rotation[None]
            shaft = pose.rotation @ tool.handle_direction(tip_mm, state.tool.tip_tracker_mm[None], turn)[0]
    numbers = {
        "t_s": now_s,
        "phi": phase.phi,
        "phase_valid": int(phase.state is PhaseState.LOCKED),
        "model_phase": state.model_phase,
        "rr_s": phase.rr_s,
        **_axes(TIP, tip),
        **_axes(SHAFT, shaft),
        "distance_mm": state.distance_mm,
        **_axes(FORCE_TRACKER, force_n),
        **_axes(FORCE_MR, force_mr),
        "pose_age_s": state.pose_age_s,
        "pose_bound_mm": state.pose_bound_mm,
        "margin_mm": float(state.margin_mm[0]),
    }
    hazards = Hazard(state.supervised.hazards) if sent is None else sent.hazards
    return {
        **{
            name: round(value, _DECIMALS[name]) if np.isfinite(value) else None
            for name, value in numbers.items()
        },
        "status": state.status.name.lower(),
        "supervisor": (state.supervisor if sent is None else sent.state).name.lower(),
        "hazards": "|".join(one.name.lower() for one in hazards if one.name),
    }


def _axes(names: tuple[str, ...], vector: FloatArray) -> dict[str, float]:
    return dict(zip(names, vector.tolist(), strict=True))
