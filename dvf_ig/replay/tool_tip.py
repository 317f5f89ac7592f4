"""The tool tip at each millisecond, predicted from what the tracker had delivered by then."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, PoseStream, read_only_arrays

MAX_AGE_S = 0.050
MAX_AGE_FRAMES = 2.5
VELOCITY_SPAN_S = 0.030
"""Velocity is the tip's displacement over about this long: three frames at 100 Hz."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TipTrack:
    """The tool tip at every tick, as predicted by then.

    Attributes:
        t_s: (n,) tick times.
        tip_tracker_mm: (n, 3) predicted tip; 0 where not valid.
        valid: (n,) False before the first pose, when the newest is too old, or while tracking is lost.
    """

    t_s: FloatArray
    tip_tracker_mm: FloatArray
    valid: BoolArray


def predict_tip(tool: PoseStream, tip_tool_mm: FloatArray, t_s: FloatArray) -> TipTrack:
    """Tip at each tick by constant velocity from the newest valid pose (docs/theory/safety.md).

    Args:
        tool: tracker_from_tool.
        tip_tool_mm: (3,) tip in the tool's frame.
        t_s: (n,) tick times on the tracker clock.
    """
    tip = tool.rotations @ tip_tool_mm + tool.translations_mm
    newest = np.searchsorted(tool.t_s, t_s, side="right") - 1
    safe = np.maximum(newest, 0)
    age = t_s - tool.t_s[safe]
    limit = min(MAX_AGE_S, MAX_AGE_FRAMES / max(tool.rate_hz, 1e-9))
    valid = (newest >= 0) & tool.valid[safe] & (age <= limit)
    velocity = _velocity(tool, tip)
    predicted = tip[safe] + velocity[safe] * age[:, None]
    return TipTrack(t_s, np.where(valid[:, None], predicted, 0.0), valid)


def _velocity(tool: PoseStream, tip: FloatArray) -> FloatArray:
    """(m, 3) backward difference over VELOCITY_SPAN_S; zero where the span holds an invalid pose."""
    steps = max(1, round(VELOCITY_SPAN_S * tool.rate_hz))
    out = np.zeros_like(tip)
    if len(tool) <= steps:
        return out
    span = tool.t_s[steps:] - tool.t_s[:-steps]
    bad = np.concatenate([[0], np.cumsum(~tool.valid)])
    clean = bad[steps + 1 :] == bad[: -steps - 1]
    clean &= span <= 2 * VELOCITY_SPAN_S
    difference = (tip[steps:] - tip[:-steps]) / span[:, None]
    out[steps:] = np.where(clean[:, None], difference, 0.0)
    return out
