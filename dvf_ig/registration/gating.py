"""Which ultrasound frames may be compared with the model, and where in its cycle each belongs."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, IntArray, phase_distance, read_only_arrays

from .frame_information import FrameInformation

PHASE_WINDOW = 0.02
"""Largest distance, in fractions of the cycle, between a frame and the model phase it is compared with."""


class FrameRejection(StrEnum):
    """Why a frame is not compared with the model; each value is what a user reads."""

    INVALID_IMAGE = "image marked invalid"
    DARK_IMAGE = "image dark"
    REPEATED_IMAGE = "image frozen"
    NOISE_IMAGE = "image without structure"
    UNTRACKED_PROBE = "probe not tracked"
    IRREGULAR_BEAT = "irregular or unfinished beat"
    BETWEEN_PHASES = "between model phases"


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Gated:
    """Frames kept, and how many were rejected for each reason (the first that applies).

    Attributes:
        index: (k,) kept frames, in time order.
        rejected: number of frames for each reason.
    """

    index: IntArray
    rejected: dict[FrameRejection, int]


def gate_frames(
    model_phase: FloatArray,
    fractions: FloatArray,
    *,
    image_valid: BoolArray,
    pose_valid: BoolArray,
    beat_valid: BoolArray,
    information: FrameInformation,
    window: float = PHASE_WINDOW,
) -> Gated:
    """Keep frames that show anatomy, with a valid image and pose, a regular beat, and a model phase close by.

    Args:
        model_phase: (n,) retimed phase of each frame, [0, 1).
        fractions: (m,) phases of the model, [0, 1).
        image_valid, pose_valid, beat_valid: (n,).
        information: of the n images.
    """
    near = phase_distance(fractions, model_phase).min(axis=1) <= window
    kept = np.ones(len(model_phase), dtype=np.bool_)
    rejected: dict[FrameRejection, int] = {}
    for reason, good in (
        (FrameRejection.INVALID_IMAGE, image_valid),
        (FrameRejection.DARK_IMAGE, ~information.dark),
        (FrameRejection.REPEATED_IMAGE, ~information.repeated),
        (FrameRejection.NOISE_IMAGE, ~information.noise),
        (FrameRejection.UNTRACKED_PROBE, pose_valid),
        (FrameRejection.IRREGULAR_BEAT, beat_valid),
        (FrameRejection.BETWEEN_PHASES, near),
    ):
        rejected[reason] = int((kept & ~good).sum())
        kept &= good
    return Gated(np.flatnonzero(kept), rejected)
