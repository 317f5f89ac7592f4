"""The force of the fixtures at every tick, through the pose and the phase that were known then."""

import itertools
from collections.abc import Sequence

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, IntArray, Rigid
from dvf_ig.guidance import Fixtures, ForceSamples, Status

from .tool_tip import TipTrack


def force_samples(
    fixtures: Fixtures,
    poses: Sequence[tuple[float, Rigid]],
    suspended: BoolArray,
    tip: TipTrack,
    model_phase: FloatArray,
    phase_valid: BoolArray,
) -> tuple[ForceSamples, BoolArray]:
    """Force at each of n ticks in frame "tracker", and which ticks were valid.

    Args:
        poses: (time from which it is in use, mr_from_tracker) in time order.
        suspended: (n,) ticks without a pose that may be used.
        model_phase, phase_valid: (n,) retimed phase, and where it may be used.
    """
    begins = np.searchsorted(tip.t_s, [start_s for start_s, _ in poses], side="left")
    refusal = np.where(suspended, Status.NO_POSE, np.where(phase_valid, Status.STALE_TOOL, Status.NO_PHASE))
    valid = ~suspended & phase_valid & tip.valid
    n = len(tip.t_s)
    force, gradient = np.zeros((n, 3)), np.full((n, 3), np.nan)
    distance, status = np.full(n, np.nan), refusal.astype(np.int64)
    for (_, mr_from_tracker), here in zip(poses, _spans(begins, n), strict=True):
        asked = np.where(valid[here], int(Status.OK), refusal[here])
        part = fixtures.evaluate(mr_from_tracker, tip.tip_tracker_mm[here], model_phase[here], asked)
        force[here], gradient[here] = part.force_n, part.gradient
        distance[here], status[here] = part.distance_mm, part.status
    return ForceSamples("tracker", force, distance, gradient, status), status == Status.OK


def _spans(begins: IntArray, n: int) -> list[slice]:
    """From each beginning to the next, the last to `n`."""
    return [slice(int(a), int(b)) for a, b in itertools.pairwise([*begins, n])]
