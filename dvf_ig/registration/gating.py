"""Which ultrasound frames may be compared with the model, and where in its cycle each belongs."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, IntArray, read_only_arrays

PHASE_WINDOW = 0.02
"""Largest distance, in fractions of the cycle, between a frame and the model phase it is compared with."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Gated:
    """Frames kept, and how many were turned away for each reason.

    Attributes:
        index: (k,) kept frames, in time order.
        rejected: reason → number of frames.
    """

    index: IntArray
    rejected: dict[str, int]


def gate_frames(
    model_phase: FloatArray,
    fractions: FloatArray,
    *,
    image_valid: BoolArray,
    pose_valid: BoolArray,
    beat_valid: BoolArray,
    window: float = PHASE_WINDOW,
) -> Gated:
    """Keep frames with a valid image, a tracked pose, a regular beat, and a model phase close by.

    Args:
        model_phase: (n,) retimed phase of each frame, [0, 1).
        fractions: (m,) phases of the model, [0, 1).
        image_valid, pose_valid, beat_valid: (n,).
    """
    away = np.abs(model_phase[:, None] - fractions[None, :])
    near = np.minimum(away, 1 - away).min(axis=1) <= window
    kept = np.ones(len(model_phase), dtype=np.bool_)
    rejected: dict[str, int] = {}
    for reason, good in (
        ("image marked invalid", image_valid),
        ("probe not tracked", pose_valid),
        ("irregular or unfinished beat", beat_valid),
        ("between model phases", near),
    ):
        rejected[reason] = int((kept & ~good).sum())
        kept &= good
    return Gated(np.flatnonzero(kept), rejected)
