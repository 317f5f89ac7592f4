"""Columns of a tick in the viewer's page: their names, and the step to which each is rounded."""

from __future__ import annotations

AXES = "xyz"
TIP = tuple(f"tip_mr_{axis}_mm" for axis in AXES)
SHAFT = tuple(f"shaft_mr_{axis}" for axis in AXES)
FORCE_TRACKER = tuple(f"force_tracker_{axis}_n" for axis in AXES)
FORCE_MR = tuple(f"force_mr_{axis}_n" for axis in AXES)

STEPS: dict[str, float] = {
    "t_s": 1e-6,
    "phi": 1e-6,
    "phase_valid": 1.0,
    "model_phase": 1e-6,
    "rr_s": 1e-6,
    **dict.fromkeys(TIP, 1e-4),
    **dict.fromkeys(SHAFT, 1e-3),
    "distance_mm": 1e-4,
    **dict.fromkeys(FORCE_TRACKER, 1e-6),
    **dict.fromkeys(FORCE_MR, 1e-5),
    "status": 1.0,
    "supervisor": 1.0,
    "hazards": 1.0,
    "pose_age_s": 1e-3,
    "pose_bound_mm": 1e-3,
    "margin_mm": 1e-4,
}
"""Rounding step of each column, as in `ticks.csv`; `force_mr` and `shaft_mr` are not in that file."""
