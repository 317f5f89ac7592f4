"""Encode a model alone for the viewer: its surfaces beat."""

from typing import Any

import numpy as np

from dvf_ig.core import DvfModel

from .scene import SceneInput, scene_payload
from .series import STEPS, SeriesInput, series_payload

MODEL_BEATS, MODEL_STEP_S = 20, 0.01


def model_payload(model: DvfModel) -> dict[str, Any]:
    """Build the scene of a model alone, `kind` "model": it beats MODEL_BEATS times at its own rate."""
    scene = scene_payload(SceneInput("model", model.patient_id, model, None, None, None))
    t_s = np.arange(0.0, MODEL_BEATS * model.timing.rr_s, MODEL_STEP_S)
    phase = t_s / model.timing.rr_s % 1.0
    unknown = np.full(len(t_s), np.nan)
    ticks = dict.fromkeys(STEPS, unknown) | {"t_s": t_s, "phi": phase, "model_phase": phase}
    ticks |= dict.fromkeys(("phase_valid", "status", "supervisor", "hazards"), np.zeros(len(t_s)))
    beats_s = np.arange(MODEL_BEATS, dtype=np.float64) * model.timing.rr_s
    series = SeriesInput(ticks, None, None, beats_s, None, ())
    rows = [
        ("surface", model.surface_name),
        ("chambers", ", ".join(chamber.name for chamber in model.chambers) or "none"),
        ("phases", f"{model.phases}, RR {model.timing.rr_s:.2f} s"),
        ("end-systole", f"{model.es_fraction:.0%} of the cycle"),
        ("knots", f"every {model.knot_spacing_mm:g} mm"),
    ]
    return {**scene, "rows": [list(row) for row in rows], "series": series_payload(series)}
