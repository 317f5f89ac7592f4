"""When the cardiac phase is lost: guidance fades, walls become those of the worst phase, and back again.

For 250 ms the composed force is (1 − c) of the fixtures at the last known phase plus c of the walls at their
worst phase, c a raised cosine of the share that has passed; so it is when the phase is found again. Both are
evaluated where the tool is now. A wall at its worst phase pushes no less than at any other, so no wall gives
way. `dvf_ig.guidance.phase_loss` is the readable form.
"""

import math
from typing import Any

from numpy.typing import NDArray

from dvf_ig.core import FloatArray
from dvf_ig.kernels import status as code
from dvf_ig.kernels.compiled import kernel
from dvf_ig.kernels.composition import compose_forces
from dvf_ig.kernels.dynamic import forces_on_surface
from dvf_ig.kernels.fixture_field import BLEND, BLEND_PERIODIC
from dvf_ig.kernels.place import pose_at, status_at
from dvf_ig.kernels.pose_and_phase import DISTANCE_RATE, DISTANCE_SIGMA, distance_rate_and_sigma
from dvf_ig.kernels.worst_phase import worst_phase_force

from .fixtures import (
    FIXTURE_CAP_N,
    FORBIDDEN,
    HELD_PHASE,
    PHASE_KNOWN,
    WORST_SHARE,
    in_model,
    to_tracker,
    turn_forces,
    widen,
)
from .published import POSE_AND_PHASE

FORCE_PARTS = 9
"""Numbers of a composition that are forces: forbidden, guidance, rejected."""


@kernel
def step_share(loss: FloatArray, status: int, step: float) -> float:
    """c after one more tick; without force there is nothing to cross from."""
    if status != code.OK and status != code.NO_PHASE:
        loss[WORST_SHARE] = loss[PHASE_KNOWN] = 0.0
        return 0.0
    target = 1.0 if status == code.NO_PHASE else 0.0
    if loss[PHASE_KNOWN] == 0.0:
        loss[WORST_SHARE] = target
    loss[WORST_SHARE] += min(max(target - loss[WORST_SHARE], -step), step)
    return 0.5 * (1.0 - math.cos(math.pi * loss[WORST_SHARE]))


@kernel
def cross_to_walls(
    linear: NDArray[Any],
    periodic: NDArray[Any],
    packed: FloatArray,
    fixtures: FloatArray,
    cap_n: float,
    inputs: FloatArray,
    t_s: float,
    xyz: FloatArray,
    status: int,
    step: float,
    loss: FloatArray,
    first: FloatArray,
    forces: FloatArray,
    work: FloatArray,
    order: FloatArray,
    composed: FloatArray,
    other: FloatArray,
) -> int:
    """Mix what `fixtures_force` gave, at OK, or nothing, at NO_PHASE, with the other case.

    Not inlined: it runs where the phase is not known, or has just been found, alone.

    Args:
        status: found by `fixtures_force`; step: share that one tick moves.
        first: at NO_PHASE gets distance, gradient, rate by the pose and σ of the first wall.
        composed: in and out; other: scratch of its size.
    Returns:
        the status; unless OK or NO_PHASE there is no force.
    """
    walls = 0
    for i in range(len(packed)):
        walls += int(fixtures[FORBIDDEN, i])
    if walls == 0:
        return status
    pose_phase = inputs[POSE_AND_PHASE:]
    if status == code.NO_PHASE:
        found = status_at(pose_phase, t_s, xyz[0] + xyz[1] + xyz[2])
        status = status if found == code.OK else found
    share = step_share(loss, status, step)
    if status != code.OK and status != code.NO_PHASE:
        return status
    pose = pose_at(pose_phase, t_s)
    place = in_model(pose, xyz)
    widen(packed, fixtures, inputs)
    if status == code.NO_PHASE and share < 1.0:
        held = forces_on_surface(linear, periodic, packed, place, loss[HELD_PHASE], forces)
        if held[0] == code.OK:
            turn_forces(pose, forces)
            compose_forces(forces, fixtures[FIXTURE_CAP_N], fixtures[FORBIDDEN], cap_n, work, order, composed)
    if status == code.NO_PHASE or share > 0.0:
        begun = False
        for i in range(len(packed)):
            forces[i, 0] = forces[i, 1] = forces[i, 2] = 0.0
            if fixtures[FORBIDDEN, i] == 0.0:
                continue
            of_model = periodic if int(packed[i, BLEND]) == BLEND_PERIODIC else linear
            worst = worst_phase_force(of_model, packed[i], place)
            if worst[0] != code.OK:
                composed[:] = loss[:] = 0.0
                first[:] = math.nan
                return worst[0]
            forces[i, 0], forces[i, 1], forces[i, 2] = worst[1]
            if status == code.NO_PHASE and not begun:
                begun = True
                first[3], first[7] = worst[2], 0.0
                first[4], first[5], first[6] = to_tracker(pose, worst[3])
                first[DISTANCE_RATE], first[DISTANCE_SIGMA] = distance_rate_and_sigma(
                    pose_phase, pose, (0.0, 0.0, 0.0), xyz, first
                )
        turn_forces(pose, forces)
        compose_forces(forces, fixtures[FIXTURE_CAP_N], fixtures[FORBIDDEN], cap_n, work, order, other)
        for k in range(FORCE_PARTS):
            composed[k] += share * (other[k] - composed[k])
        if status == code.NO_PHASE:
            for k in range(FORCE_PARTS, len(composed)):
                composed[k] = other[k]
    return status
