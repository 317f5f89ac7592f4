"""Which pose is in use when: a new registration enters guidance by bounded motion, never by a jump."""

import math
from collections.abc import Sequence

from scipy.spatial.transform import Rotation

from dvf_ig.core import FloatArray, Rigid
from dvf_ig.registration import HEART_RADIUS_MM, distance_between

UPDATE_MM_PER_S = 10.0
"""Fastest motion of the model by a registration update (theory: safety)."""
STEP_S = 0.005


def pose_schedule(
    registered: Sequence[tuple[float, Rigid]], center_mm: FloatArray
) -> tuple[tuple[float, Rigid], ...]:
    """Poses with the times from which each is in use.

    Args:
        registered: (time from which it may be used, mr_from_tracker), in time order.
        center_mm: (3,) centre of the heart box; the speed bound holds over the heart about it.
    """
    schedule: list[tuple[float, Rigid]] = []
    for ready_s, target in registered:
        if not schedule:
            schedule.append((ready_s, target))
            continue
        held = [pose for start_s, pose in schedule if start_s <= ready_s][-1]
        schedule = [entry for entry in schedule if entry[0] < ready_s]
        way_mm = distance_between(held, target, center_mm, HEART_RADIUS_MM)
        steps = max(1, math.ceil(way_mm / UPDATE_MM_PER_S / STEP_S))
        schedule += [
            (ready_s + (i - 1) * STEP_S, _between(held, target, center_mm, i / steps))
            for i in range(1, steps)
        ]
        schedule.append((ready_s + (steps - 1) * STEP_S, target))
    return tuple(schedule)


def _between(first: Rigid, second: Rigid, center_mm: FloatArray, weight: float) -> Rigid:
    """Part of the way between two poses, turning about the heart so that it moves at a steady speed."""
    step = second @ first.inverse()
    turn = Rotation.from_matrix(step.rotation).as_rotvec()
    shift = step.apply_array(center_mm) - center_mm
    return first.perturbed_left(weight * turn, weight * shift, center_mm)
