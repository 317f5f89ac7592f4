"""The dynamic fixture of a tracked tool at a time: the pose-and-phase transform, then the fixture's force.

`dvf_ig.guidance.PoseAndPhase` is the readable form.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, IntArray

from . import status as code
from .compiled import inlined, kernel
from .dynamic import contracted_by_mm, force_at, force_tick, rotated_back, transformed
from .fixture_field import CONTRACTION, POSE, WITHOUT_RATE, no_output
from .place import Columns, Phase, phase_at, pose_at, status_at
from .vectors import Vector, cross, dot, vector_at
from .warp import contraction_at, known_share, output_through, warp_at
from .worst_phase import is_wall, wall_without_phase

DISTANCE_RATE = 8
"""Offsets in the output of a guided tick: ∂d/∂t at the tool's position, mm/s; then σ_d in mm."""
DISTANCE_SIGMA = 9
GUIDED_SIZE = 10


@inlined
def _distance_variance(p: Any, at: Vector, g: Vector) -> float:
    """Variance of d by the pose: h Σ hᵀ with h = ((p − c) × ∇d/radius, ∇d)."""
    c = vector_at(p.covariance_center_mm, 0)
    torque = cross((at[0] - c[0], at[1] - c[1], at[2] - c[2]), g)
    scale = p.turn_per_mm
    h = (scale * torque[0], scale * torque[1], scale * torque[2], g[0], g[1], g[2])
    total = 0.0
    for i in range(6):
        row = 0.0
        for j in range(6):
            row += p.covariance[i, j] * h[j]
        total += h[i] * row
    return total


@inlined
def rotated_by(pose: Columns, v: Vector) -> Vector:
    """Rotation of the pose times a vector."""
    x, y, z = pose[0], pose[1], pose[2]
    return (
        x[0] * v[0] + y[0] * v[1] + z[0] * v[2],
        x[1] * v[0] + y[1] * v[1] + z[1] * v[2],
        x[2] * v[0] + y[2] * v[1] + z[2] * v[2],
    )


@inlined
def distance_rate_and_sigma(
    packed: Any, pose: Columns, phase: Phase, xyz_mm: FloatArray, gradient: Vector, rate_mm_per_cycle: float
) -> tuple[float, float]:
    """Compute ∂d/∂t at a fixed position (mm/s), by the pose's twist and the phase's rate, and σ_d (mm).

    Args:
        packed: pose and phase; pose, phase: of that, at the time.
        xyz_mm: (3,) tool tip, tracker frame; gradient: of the distance there, tracker frame.
    """
    turned, in_model = rotated_by(pose, vector_at(xyz_mm, 0)), rotated_by(pose, gradient)
    shift = pose[3]
    at = (turned[0] + shift[0], turned[1] + shift[1], turned[2] + shift[2])
    swept, moved = cross(pose[4], at), pose[5]
    velocity = (swept[0] + moved[0], swept[1] + moved[1], swept[2] + moved[2])
    by_phase = rate_mm_per_cycle * phase[2]
    variance = _distance_variance(packed, at, in_model)
    sigma = math.sqrt((0.0 if variance < 0.0 else variance) + by_phase**2)
    return dot(in_model, velocity) + rate_mm_per_cycle * phase[1], sigma


@inlined
def distance_rate(
    pose: Columns, phase: Phase, xyz_mm: FloatArray, gradient: Vector, rate_mm_per_cycle: float
) -> float:
    """Compute ∂d/∂t alone, as `distance_rate_and_sigma` does; `gradient` in the model's frame."""
    turned, shift = rotated_by(pose, vector_at(xyz_mm, 0)), pose[3]
    swept = cross(pose[4], (turned[0] + shift[0], turned[1] + shift[1], turned[2] + shift[2]))
    moved = pose[5]
    velocity = (swept[0] + moved[0], swept[1] + moved[1], swept[2] + moved[2])
    return dot(gradient, velocity) + rate_mm_per_cycle * phase[1]


@inlined
def _set_pose(fixture: FloatArray, pose: Columns) -> None:
    """Write the (3, 4) pose of a packed fixture row by row."""
    for row in range(3):
        for column in range(4):
            fixture[POSE + 4 * row + column] = pose[column][row]


@kernel
def _warped_tick(
    coefficients: NDArray[np.float32],
    fixture: FloatArray,
    packed: Any,
    warps: NDArray[np.float32],
    t_s: float,
    xyz_mm: FloatArray,
    phase: Phase,
    status: int,
    out: FloatArray,
) -> int:
    """Compute `guided_tick` through a warp; `fixture` holds the pose at `t_s`. Not inlined: it is rare."""
    q = transformed(fixture, xyz_mm[0], xyz_mm[1], xyz_mm[2])
    at, slope, variance, moving = warp_at(warps, packed, t_s, q)
    share = known_share(variance)
    fixture[CONTRACTION], per_s = contraction_at(packed, t_s)
    if share == 0.0:
        output = no_output(code.UNSEEN)
    elif status == code.OK:
        output = force_at(coefficients, fixture, at, phase[0], slope)
    else:
        output = wall_without_phase(coefficients, fixture, at, slope)
    (status, force, d, gradient, rate), by_warp = output_through(output, slope, share, moving)
    if per_s != 0.0:
        by_warp -= per_s * contracted_by_mm(coefficients, fixture, at, phase[0])
    out[0], out[1], out[2] = rotated_back(fixture, force)
    out[3] = d
    out[4], out[5], out[6] = rotated_back(fixture, gradient)
    if len(out) > WITHOUT_RATE:
        out[WITHOUT_RATE] = rate
    if len(out) > DISTANCE_SIGMA:
        pose = pose_at(packed, t_s)
        by_place, sigma = distance_rate_and_sigma(packed, pose, phase, xyz_mm, vector_at(out, 4), rate)
        out[DISTANCE_RATE] = by_place - by_warp
        out[DISTANCE_SIGMA] = math.sqrt(sigma * sigma + variance)
    return status


@kernel
def guided_tick(
    coefficients: NDArray[np.float32],
    fixture: FloatArray,
    packed: Any,
    warps: NDArray[np.float32],
    t_s: float,
    xyz_mm: FloatArray,
    input_status: int,
    out: FloatArray,
) -> int:
    """Compute the force at one point and time: the pose-and-phase transform, then `force_tick`.

    Args:
        coefficients: as in `force_tick`.
        fixture: the caller's own `packed_fixture`; its pose is overwritten.
        packed: POSE_AND_PHASE; warps: `packed_warps` of its change of shape.
        t_s: time of the tool's pose.
        xyz_mm: (3,) tool tip, tracker frame.
        input_status: status of the tool's pose; anything but OK is returned with zero force, except that a
            wall has the force of its worst phase at NO_PHASE, from either source.
        out: (7,) or (8,) as in `force_tick`; (10,) for ∂d/∂t at a fixed position in mm/s, and the
            standard deviation of the distance in mm, as well.
    Returns:
        status code; unless OK, or NO_PHASE of a wall, the force is zero and the rest NaN.
    """
    status = input_status
    if status == code.OK or status == code.NO_PHASE:
        own_status = status_at(packed, t_s, xyz_mm[0] + xyz_mm[1] + xyz_mm[2])
        status = status if own_status == code.OK else own_status
    phase = (math.nan, math.nan, math.nan)
    if status != code.OK and not (status == code.NO_PHASE and is_wall(fixture)):
        if len(out) > DISTANCE_SIGMA:
            out[DISTANCE_RATE] = out[DISTANCE_SIGMA] = math.nan
        return force_tick(coefficients, fixture, xyz_mm, phase[0], status, out)
    pose, phase = pose_at(packed, t_s), (0.0, 0.0, 0.0)
    if status == code.OK:
        phase = phase_at(packed, t_s)
    _set_pose(fixture, pose)
    fixture[CONTRACTION] = 1.0
    if packed.warped != 0.0:
        return _warped_tick(coefficients, fixture, packed, warps, t_s, xyz_mm, phase, status, out)
    status = force_tick(coefficients, fixture, xyz_mm, phase[0], status, out)
    if len(out) > DISTANCE_SIGMA:
        out[DISTANCE_RATE], out[DISTANCE_SIGMA] = distance_rate_and_sigma(
            packed, pose, phase, xyz_mm, vector_at(out, 4), out[WITHOUT_RATE]
        )
    return status


@kernel
def guided_batch(
    coefficients: NDArray[np.float32],
    fixture: FloatArray,
    packed: Any,
    warps: NDArray[np.float32],
    t_s: FloatArray,
    xyz_mm: FloatArray,
    status: IntArray,
    out: FloatArray,
) -> None:
    """Compute `guided_tick` at (k,) times and (k, 3) points: (k,) status in and out, (k, 10) out."""
    for n in range(len(t_s)):
        status[n] = guided_tick(coefficients, fixture, packed, warps, t_s[n], xyz_mm[n], status[n], out[n])
