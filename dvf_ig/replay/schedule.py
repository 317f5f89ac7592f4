"""Which pose is in use when: an update enters guidance by bounded motion, never by a jump."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import BoolArray, FloatArray, Rigid
from dvf_ig.registration import mean_displacement_mm

from .pose_history import PoseUpdates

UPDATE_MM_PER_S = 10.0
"""Fastest motion of the model by a registration update (docs/theory/safety.md)."""
STEP_S = 0.005


def pose_schedule(updates: PoseUpdates, center_mm: FloatArray) -> tuple[tuple[float, Rigid], ...]:
    """Poses with the times from which each is in use.

    Args:
        updates: (time from which it may be used, mr_from_tracker), in time order; None where the pose in use
            was suspended. The first pose after that is in use at once: no force depends on the one before.
        center_mm: (3,) centre of the heart box; the speed bound holds over the heart about it.
    """
    schedule: list[tuple[float, Rigid]] = []
    suspended = True
    for ready_s, target in updates:
        was_suspended = suspended
        suspended = target is None
        held = next((pose for from_s, pose in reversed(schedule) if from_s <= ready_s), target)
        while schedule and schedule[-1][0] >= ready_s:
            schedule.pop()
        if target is None or held is None:
            continue
        way_mm = 0.0 if was_suspended else mean_displacement_mm(held, target, center_mm)
        steps = max(1, math.ceil(way_mm / UPDATE_MM_PER_S / STEP_S))
        schedule += [
            (ready_s + (i - 1) * STEP_S, _between(held, target, center_mm, i / steps))
            for i in range(1, steps)
        ]
        schedule.append((ready_s + (steps - 1) * STEP_S, target))
    return tuple(schedule)


def suspended_at(updates: PoseUpdates, t_s: FloatArray) -> BoolArray:
    """(n,) ticks before the first pose, and those at which the pose in use was suspended."""
    which = np.searchsorted([from_s for from_s, _ in updates], t_s, side="right")
    return np.array([True, *(pose is None for _, pose in updates)])[which]


def _between(first: Rigid, second: Rigid, center_mm: FloatArray, weight: float) -> Rigid:
    """Part of the way between two poses, rotating about the heart so that it moves at a steady speed."""
    step = second @ first.inverse()
    turn = Rotation.from_matrix(step.rotation).as_rotvec()
    shift = step.apply_array(center_mm) - center_mm
    return first.perturbed_left(weight * turn, weight * shift, center_mm)
