"""All fixtures of a servo at one place and time, in the tracker's frame."""

import math
from typing import Any

from numpy.typing import NDArray

from dvf_ig.core import FloatArray
from dvf_ig.kernels import status as code
from dvf_ig.kernels.compiled import inlined
from dvf_ig.kernels.composition import compose_forces
from dvf_ig.kernels.dynamic import forces_on_surface
from dvf_ig.kernels.fixture_field import DEPTH, LAW
from dvf_ig.kernels.place import Columns, phase_at, pose_at, status_at
from dvf_ig.kernels.pose_and_phase import DISTANCE_RATE, DISTANCE_SIGMA, distance_rate_and_sigma
from dvf_ig.kernels.vectors import Vector, dot

from .published import MARGIN_MM, POSE_AND_PHASE

# Rows of the fixtures' constants.
FIXTURE_CAP_N = 0
FORBIDDEN = 1
BASE_WIDTH = 2
BASE_DEPTH = 3
WIDEN_WIDTH = 4
"""Share of the margin by which a law's width grows: 1 of a guidance, which it softens."""
WIDEN_DEPTH = 5
"""−1 of a forbidden region, +1 of a confinement, in the kernel's sign of depth: both widen the region."""
FIXTURE_SIZE = 6

# Offsets in what is remembered of the phase, `loss`.
WORST_SHARE = 0
"""Progress from the fixtures of a known phase, 0, to the walls of the worst one, 1."""
HELD_PHASE = 1
PHASE_KNOWN = 2
LOSS_SIZE = 3


@inlined
def in_model(pose: Columns, p: FloatArray) -> Vector:
    """A point (3,) of the tracker's frame in the model's."""
    x, y, z, t = pose[0], pose[1], pose[2], pose[3]
    return (
        x[0] * p[0] + y[0] * p[1] + z[0] * p[2] + t[0],
        x[1] * p[0] + y[1] * p[1] + z[1] * p[2] + t[1],
        x[2] * p[0] + y[2] * p[1] + z[2] * p[2] + t[2],
    )


@inlined
def to_tracker(pose: Columns, v: Vector) -> Vector:
    """A free vector of the model's frame in the tracker's."""
    return dot(pose[0], v), dot(pose[1], v), dot(pose[2], v)


@inlined
def widen(packed: FloatArray, fixtures: FloatArray, inputs: FloatArray) -> None:
    """Set the laws to those with the published margins."""
    for i in range(len(packed)):
        margin = inputs[MARGIN_MM + i]
        packed[i, LAW + 1] = fixtures[BASE_WIDTH, i] + fixtures[WIDEN_WIDTH, i] * margin
        packed[i, DEPTH] = fixtures[BASE_DEPTH, i] + fixtures[WIDEN_DEPTH, i] * margin


@inlined
def turn_forces(pose: Columns, forces: FloatArray) -> None:
    """(k, 3) forces of the model's frame, in place, in the tracker's."""
    for i in range(len(forces)):
        forces[i, 0], forces[i, 1], forces[i, 2] = to_tracker(
            pose, (forces[i, 0], forces[i, 1], forces[i, 2])
        )


@inlined
def fixtures_force(
    linear: NDArray[Any],
    periodic: NDArray[Any],
    packed: FloatArray,
    fixtures: FloatArray,
    cap_n: float,
    inputs: FloatArray,
    t_s: float,
    xyz: FloatArray,
    input_status: int,
    loss: FloatArray,
    first: FloatArray,
    forces: FloatArray,
    work: FloatArray,
    order: FloatArray,
    composed: FloatArray,
) -> int:
    """All fixtures' force at one place and time: `composed`; distance, gradient, rates, σ in `first`.

    The phase is remembered in `loss` (`dvf_ig.kernels.servo.phase_loss`); where it is not known there is no
    force from here.
    """
    pose_phase = inputs[POSE_AND_PHASE:]
    status = input_status
    if status == code.OK:
        status = status_at(pose_phase, t_s, xyz[0] + xyz[1] + xyz[2])
    composed[:] = 0.0
    first[:] = math.nan
    if status != code.OK:
        return status
    pose, phase = pose_at(pose_phase, t_s), phase_at(pose_phase, t_s)
    loss[HELD_PHASE], loss[PHASE_KNOWN] = phase[0], 1.0
    widen(packed, fixtures, inputs)
    found = forces_on_surface(linear, periodic, packed, in_model(pose, xyz), phase[0], forces)
    if found[0] != code.OK:
        return found[0]
    turn_forces(pose, forces)
    gradient = to_tracker(pose, found[3])
    first[3], first[4], first[5], first[6], first[7] = (
        found[2],
        gradient[0],
        gradient[1],
        gradient[2],
        found[4],
    )
    compose_forces(forces, fixtures[FIXTURE_CAP_N], fixtures[FORBIDDEN], cap_n, work, order, composed)
    first[DISTANCE_RATE], first[DISTANCE_SIGMA] = distance_rate_and_sigma(pose_phase, pose, phase, xyz, first)
    return code.OK
