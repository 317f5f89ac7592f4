"""Pose, model phase, their rates and uncertainty at a time, from one record.

Everything is a closed form of time between two events (docs/theory/fixtures.md), so the record holds until
the next pose, R peak or confirmation. Readable forms: `dvf_ig.core.PoseMotion`, `PhaseForecast`,
`RetimingCurve`.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import (
    HEART_RADIUS_MM,
    FloatArray,
    PhaseForecast,
    PhaseState,
    PoseMotion,
    RetimingCurve,
    WarpMotion,
)
from dvf_ig.core.space.warp import COEFFICIENTS

from . import status as code
from .compiled import inlined, kernel
from .vectors import Vector, cross, dot, vector_at

_F = np.float64
POSE_AND_PHASE = np.dtype(
    [
        ("pose_until_s", _F),
        ("start_s", _F),
        ("end_s", _F),
        ("start_pose", _F, (3, 4)),
        ("end_pose", _F, (3, 4)),
        ("center_mm", _F, (3,)),
        ("axis", _F, (3,)),
        ("angle_rad", _F),
        ("shift_mm", _F, (3,)),
        ("phase_since_s", _F),
        ("phase_until_s", _F),
        ("phi", _F),
        ("r_s", _F),
        ("cycles", _F),
        ("rr_s", _F),
        ("spread", _F),
        ("catch_up", _F),
        ("r_timing_s", _F),
        ("end_systole", _F),
        ("model_end_systole", _F),
        ("slope_at_r", _F),
        ("slope_at_end_systole", _F),
        ("covariance_center_mm", _F, (3,)),
        ("covariance", _F, (6, 6)),
        ("turn_per_mm", _F),
        ("warped", _F),
        ("warp_start_s", _F),
        ("warp_end_s", _F),
        ("warp_origin_mm", _F, (3,)),
        ("warp_per_mm", _F),
        ("contraction", _F, (2,)),
    ]
)
"""Pose, phase and change of shape as functions of time; `turn_per_mm`: radians a mm of the covariance's
rotation; `warped` is 0 if the heart has kept its shape, `contraction` that before and after the motion of the
warp. Coefficients of warps are apart (`packed_warps`)."""

PLACE = np.dtype(
    [
        ("model_from_tracker", _F, (3, 4)),
        ("turn_rate", _F, (3,)),
        ("origin_velocity", _F, (3,)),
        ("model_phase", _F),
        ("model_phase_rate", _F),
        ("model_phase_sigma", _F),
    ]
)
"""Pose and phase at one time: turn rate in rad/s, velocity in mm/s with v(p) = turn rate × p + velocity of
the origin, both in the model's frame; the phase's rate in cycles a second."""

Columns = tuple[Vector, Vector, Vector, Vector, Vector, Vector]
"""Columns of the pose's rotation, its translation, turn rate, velocity of the tracker's origin."""
Phase = tuple[float, float, float]
"""Model phase, its rate, its standard deviation."""


def packed_pose_and_phase(
    pose: PoseMotion | None,
    pose_until_s: float,
    phase: PhaseForecast,
    retiming: RetimingCurve | None,
    covariance_mm2: FloatArray | None,
    center_mm: FloatArray,
    warp: WarpMotion | None = None,
) -> Any:
    """(1,) POSE_AND_PHASE for `place_tick` and `guided_tick`; arguments as in `dvf_ig.guidance.PoseAndPhase`.

    A missing pose, and a phase that is not LOCKED or cannot be retimed, get an end before their start.
    """
    packed = np.zeros(1, POSE_AND_PHASE)
    packed.view(np.float64)[:] = np.nan
    p = packed[0]
    p["pose_until_s"] = -math.inf if pose is None else pose_until_s
    if pose is not None:
        angle = math.sqrt(pose.turn_rad @ pose.turn_rad)
        p["start_s"], p["end_s"] = pose.start_s, pose.end_s
        for name, end in (("start_pose", pose.start), ("end_pose", pose.end)):
            p[name][:, :3], p[name][:, 3] = end.rotation, end.translation_mm
        p["center_mm"], p["shift_mm"], p["angle_rad"] = pose.center_mm, pose.shift_mm, angle
        p["axis"] = pose.turn_rad / angle if angle > 0.0 else 0.0
    usable = phase.state == PhaseState.LOCKED and retiming is not None
    p["phase_since_s"] = phase.since_s
    p["phase_until_s"] = phase.until_s if usable else -math.inf
    for name in ("phi", "r_s", "cycles", "rr_s", "spread", "catch_up", "r_timing_s"):
        p[name] = getattr(phase, name)
    if retiming is not None:
        for name in ("end_systole", "model_end_systole", "slope_at_r", "slope_at_end_systole"):
            p[name] = getattr(retiming, name)
    p["covariance_center_mm"] = center_mm
    if covariance_mm2 is not None:
        p["covariance"] = covariance_mm2
    p["turn_per_mm"] = 1.0 / HEART_RADIUS_MM
    p["warped"] = 0.0 if warp is None else 1.0
    if warp is not None:
        p["warp_start_s"], p["warp_end_s"] = warp.start_s, warp.end_s
        p["warp_origin_mm"], p["warp_per_mm"] = warp.end.origin_mm, 1.0 / warp.end.knot_mm
        p["contraction"] = warp.start.contraction, warp.end.contraction
    return packed


def packed_warps(warp: WarpMotion | None) -> NDArray[np.float32]:
    """(2, n, n, 4 n) coefficients before and after a motion, for `dvf_ig.kernels.warp`; None has none."""
    if warp is None:
        return np.zeros((2, 1, 1, 4), dtype=np.float32)
    rows = (COEFFICIENTS, COEFFICIENTS, 4 * COEFFICIENTS)
    return np.stack([one.coefficients.reshape(rows) for one in (warp.start, warp.end)])


@inlined
def _column(matrix: FloatArray, k: int) -> Vector:
    """Column of a (3, 4) matrix."""
    return matrix[0, k], matrix[1, k], matrix[2, k]


@inlined
def _turned(axis: Vector, sine: float, cosine: float, v: Vector) -> Vector:
    """Rotate by Rodrigues: v cos + (k × v) sin + k (k·v)(1 − cos)."""
    side, along = cross(axis, v), (1.0 - cosine) * dot(axis, v)
    return (
        v[0] * cosine + side[0] * sine + axis[0] * along,
        v[1] * cosine + side[1] * sine + axis[1] * along,
        v[2] * cosine + side[2] * sine + axis[2] * along,
    )


@inlined
def _pose_between(p: Any, t_s: float) -> Columns:
    """Within the motion: docs of `dvf_ig.core.space.pose_motion`."""
    duration = p.end_s - p.start_s
    weight = (t_s - p.start_s) / duration
    axis, c, s = vector_at(p.axis, 0), vector_at(p.center_mm, 0), vector_at(p.shift_mm, 0)
    sine, cosine = math.sin(weight * p.angle_rad), math.cos(weight * p.angle_rad)
    moved = (c[0] + weight * s[0], c[1] + weight * s[1], c[2] + weight * s[2])
    first = _column(p.start_pose, 3)
    arm = _turned(axis, sine, cosine, (first[0] - c[0], first[1] - c[1], first[2] - c[2]))
    speed = p.angle_rad / duration
    turn = (speed * axis[0], speed * axis[1], speed * axis[2])
    carried = cross(turn, moved)
    return (
        _turned(axis, sine, cosine, _column(p.start_pose, 0)),
        _turned(axis, sine, cosine, _column(p.start_pose, 1)),
        _turned(axis, sine, cosine, _column(p.start_pose, 2)),
        (arm[0] + moved[0], arm[1] + moved[1], arm[2] + moved[2]),
        turn,
        (s[0] / duration - carried[0], s[1] / duration - carried[1], s[2] / duration - carried[2]),
    )


@inlined
def pose_at(p: Any, t_s: float) -> Columns:
    """Pose and its rates at a time; before and after its motion it stands still."""
    if p.start_s <= t_s and t_s < p.end_s:
        return _pose_between(p, t_s)
    pose, still = (p.end_pose if t_s >= p.end_s else p.start_pose), (0.0, 0.0, 0.0)
    return _column(pose, 0), _column(pose, 1), _column(pose, 2), _column(pose, 3), still, still


@inlined
def _retimed(p: Any, phi: float) -> tuple[float, float]:
    """Model phase and its slope: docs of `dvf_ig.core.timing.retiming_curve`."""
    early = phi <= p.end_systole
    width = p.end_systole if early else 1.0 - p.end_systole
    height = p.model_end_systole if early else 1.0 - p.model_end_systole
    bottom = 0.0 if early else p.model_end_systole
    first = p.slope_at_r if early else p.slope_at_end_systole
    last = p.slope_at_end_systole if early else p.slope_at_r
    u = (phi if early else phi - p.end_systole) / width
    rest = 1.0 - u
    cubic = height * u * u * (3 - 2 * u) + first * width * u * rest**2 - last * width * u * u * rest
    slope = 6 * height / width * u * rest + first * rest * (1 - 3 * u) - last * u * (2 - 3 * u)
    return min(max(bottom + cubic, 0.0), 1.0 - 2.0**-53), slope


@inlined
def phase_at(p: Any, t_s: float) -> Phase:
    """Model phase, its rate, its standard deviation: docs of `dvf_ig.core.timing.phase_forecast`."""
    rr, phi = p.rr_s, p.phi
    target = p.cycles + (t_s - p.r_s) / rr
    caught = phi + p.catch_up * (t_s - p.phase_since_s) / rr
    unwrapped = max(phi, min(target, caught))
    rate = p.catch_up if caught < target else (1.0 if target > phi else 0.0)
    spread, timing = p.spread * max(0.0, t_s - p.r_s) / rr, p.r_timing_s / rr
    sigma = math.sqrt(spread**2 + timing**2 + (target - unwrapped) ** 2)
    model_phase, slope = _retimed(p, unwrapped - np.floor(unwrapped))
    return model_phase, slope * rate / rr, slope * sigma


@inlined
def status_at(p: Any, t_s: float, finite: float) -> int:
    """FAULT before NO_POSE before NO_PHASE.

    Args:
        finite: a sum of all other numbers that must be finite.
    """
    if not math.isfinite(t_s + finite):
        return code.FAULT
    if t_s >= p.pose_until_s:
        return code.NO_POSE
    if not (p.phase_since_s <= t_s and t_s <= p.phase_until_s):
        return code.NO_PHASE
    return code.OK


@kernel
def place_tick(packed: Any, t_s: float, place: Any) -> int:
    """Pose, model phase and their rates at one time.

    Args:
        packed: POSE_AND_PHASE.
        place: PLACE; NaN where not known: the pose at NO_POSE, the phase at NO_PHASE, all at FAULT.
    Returns:
        status code.
    """
    place.model_phase = place.model_phase_rate = place.model_phase_sigma = math.nan
    for k in range(3):
        place.turn_rate[k] = place.origin_velocity[k] = math.nan
        for column in range(4):
            place.model_from_tracker[k, column] = math.nan
    status = status_at(packed, t_s, 0.0)
    if status == code.FAULT:
        return status
    if t_s < packed.pose_until_s:
        pose = pose_at(packed, t_s)
        for k in range(3):
            for column in range(4):
                place.model_from_tracker[k, column] = pose[column][k]
            place.turn_rate[k], place.origin_velocity[k] = pose[4][k], pose[5][k]
    if packed.phase_since_s <= t_s and t_s <= packed.phase_until_s:
        phase = phase_at(packed, t_s)
        place.model_phase, place.model_phase_rate, place.model_phase_sigma = phase
    return status
