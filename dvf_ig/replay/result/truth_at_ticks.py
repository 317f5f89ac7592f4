"""The true phase, distance and force at each tick of a replay, from the truth of its scenario."""

from typing import Any

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.guidance import force_at_distance
from dvf_ig.replay.engine import Replay


def true_phases(replay: Replay) -> tuple[FloatArray, FloatArray]:
    """Look up (n,) true fraction of RR and true model phase at each tick (nearest truth sample)."""
    truth = replay.scenario.truth
    if truth is None:
        raise InvalidInputError("the scenario carries no truth")
    nearest = _nearest(truth.tool.t_s, replay.ticks.t_s)
    return truth.tool.phi[nearest], truth.tool.model_phase[nearest]


def true_contact(replay: Replay) -> tuple[FloatArray, FloatArray | None]:
    """Look up (n,) true distance and (n, 3) true force (tracker frame) at each tick; None for a path."""
    truth = replay.scenario.truth
    if truth is None:
        raise InvalidInputError("the scenario carries no truth")
    t_s = replay.ticks.t_s
    nearest = _nearest(truth.tool.t_s, t_s)
    distance, normal = truth.tool.distance_mm[nearest], truth.tool.normal[nearest]
    force_mr = force_at_distance(replay.setup.fixtures, distance, normal)
    if force_mr is None:
        return distance, None
    force = np.empty_like(force_mr)
    for start_s, pose in truth.mr_from_tracker:
        later = t_s >= start_s
        force[later] = force_mr[later] @ pose.rotation
    return distance, force


def _nearest(times: FloatArray, at: FloatArray) -> np.ndarray[Any, np.dtype[np.intp]]:
    right = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    return right - (at - times[right - 1] < times[right] - at)
