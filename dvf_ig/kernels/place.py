"""Pose, model phase, their rates and uncertainty at a time, from one packed array.

Everything is a closed form of time between two events (docs/theory/fixtures.md), so the array holds until
the next pose, R peak or confirmation. Readable forms: `dvf_ig.core.PoseMotion`, `PhaseForecast`,
`RetimingCurve`.
"""

import math

import numpy as np

from dvf_ig.core import HEART_RADIUS_MM, FloatArray, PhaseForecast, PhaseState, PoseMotion, RetimingCurve

from . import status as code
from .compiled import inlined, kernel
from .vectors import Vector, cross, dot, vector_at

# Offsets in a packed pose and phase.
POSE_UNTIL = 0
START_S = 1
END_S = 2
START_POSE = 3
END_POSE = 15
CENTER = 27
AXIS = 30
ANGLE = 33
SHIFT = 34
PHASE_SINCE = 37
PHASE_UNTIL = 38
PHI = 39
R_S = 40
CYCLES = 41
RR_S = 42
SPREAD = 43
CATCH_UP = 44
R_TIMING_S = 45
END_SYSTOLE = 46
MODEL_END_SYSTOLE = 47
SLOPE_AT_R = 48
SLOPE_AT_END_SYSTOLE = 49
COVARIANCE_CENTER = 50
COVARIANCE = 53
COVARIANCE_TURN = 89
"""Radians a mm of the covariance's rotation."""
PACKED_SIZE = 90

# Offsets in a place.
MODEL_FROM_TRACKER = 0
"""(3, 4), row by row."""
TURN_RATE = 12
"""(3,) rad/s, model frame."""
ORIGIN_VELOCITY = 15
"""(3,) mm/s: v(p) = turn rate × p + this."""
MODEL_PHASE = 18
MODEL_PHASE_RATE = 19
"""Cycles a second."""
MODEL_PHASE_SIGMA = 20
PLACE_SIZE = 21

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
) -> FloatArray:
    """Pack one array for `place_tick` and `guided_tick`; arguments as in `dvf_ig.guidance.PoseAndPhase`.

    A missing pose, and a phase that is not LOCKED or cannot be retimed, get an end before their start.
    """
    p = np.full(PACKED_SIZE, np.nan)
    p[POSE_UNTIL] = -math.inf if pose is None else pose_until_s
    if pose is not None:
        angle = math.sqrt(pose.turn_rad @ pose.turn_rad)
        p[START_S : END_S + 1] = pose.start_s, pose.end_s
        for offset, end in ((START_POSE, pose.start), (END_POSE, pose.end)):
            matrix = p[offset : offset + 12].reshape(3, 4)
            matrix[:, :3], matrix[:, 3] = end.rotation, end.translation_mm
        p[CENTER : CENTER + 3] = pose.center_mm
        p[AXIS : AXIS + 3] = pose.turn_rad / angle if angle > 0.0 else 0.0
        p[ANGLE], p[SHIFT : SHIFT + 3] = angle, pose.shift_mm
    usable = phase.state == PhaseState.LOCKED and retiming is not None
    p[PHASE_SINCE : R_TIMING_S + 1] = (
        phase.since_s,
        phase.until_s if usable else -math.inf,
        phase.phi,
        phase.r_s,
        phase.cycles,
        phase.rr_s,
        phase.spread,
        phase.catch_up,
        phase.r_timing_s,
    )
    if retiming is not None:
        p[END_SYSTOLE : SLOPE_AT_END_SYSTOLE + 1] = (
            retiming.end_systole,
            retiming.model_end_systole,
            retiming.slope_at_r,
            retiming.slope_at_end_systole,
        )
    p[COVARIANCE_CENTER : COVARIANCE_CENTER + 3] = center_mm
    if covariance_mm2 is not None:
        p[COVARIANCE : COVARIANCE + 36] = covariance_mm2.ravel()
    p[COVARIANCE_TURN] = 1.0 / HEART_RADIUS_MM
    return p


@inlined
def _column(p: FloatArray, at: int) -> Vector:
    """Read a column of a (3, 4) matrix stored row by row."""
    return p[at], p[at + 4], p[at + 8]


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
def _pose_between(p: FloatArray, t_s: float) -> Columns:
    """Compute the pose within its motion; see `dvf_ig.core.space.pose_motion`."""
    duration = p[END_S] - p[START_S]
    weight = (t_s - p[START_S]) / duration
    axis, c, s = vector_at(p, AXIS), vector_at(p, CENTER), vector_at(p, SHIFT)
    sine, cosine = math.sin(weight * p[ANGLE]), math.cos(weight * p[ANGLE])
    moved = (c[0] + weight * s[0], c[1] + weight * s[1], c[2] + weight * s[2])
    first = _column(p, START_POSE + 3)
    arm = _turned(axis, sine, cosine, (first[0] - c[0], first[1] - c[1], first[2] - c[2]))
    speed = p[ANGLE] / duration
    turn = (speed * axis[0], speed * axis[1], speed * axis[2])
    carried = cross(turn, moved)
    return (
        _turned(axis, sine, cosine, _column(p, START_POSE)),
        _turned(axis, sine, cosine, _column(p, START_POSE + 1)),
        _turned(axis, sine, cosine, _column(p, START_POSE + 2)),
        (arm[0] + moved[0], arm[1] + moved[1], arm[2] + moved[2]),
        turn,
        (s[0] / duration - carried[0], s[1] / duration - carried[1], s[2] / duration - carried[2]),
    )


@inlined
def pose_at(p: FloatArray, t_s: float) -> Columns:
    """Compute pose and rates at a time; the pose is constant before and after its motion."""
    if p[START_S] <= t_s and t_s < p[END_S]:
        return _pose_between(p, t_s)
    at, still = (END_POSE if t_s >= p[END_S] else START_POSE), (0.0, 0.0, 0.0)
    x, y, z = _column(p, at), _column(p, at + 1), _column(p, at + 2)
    return x, y, z, _column(p, at + 3), still, still


@inlined
def _retimed(p: FloatArray, phi: float) -> tuple[float, float]:
    """Compute model phase and its slope; see `dvf_ig.core.timing.retiming_curve`."""
    early = phi <= p[END_SYSTOLE]
    width = p[END_SYSTOLE] if early else 1.0 - p[END_SYSTOLE]
    height = p[MODEL_END_SYSTOLE] if early else 1.0 - p[MODEL_END_SYSTOLE]
    bottom = 0.0 if early else p[MODEL_END_SYSTOLE]
    first = p[SLOPE_AT_R] if early else p[SLOPE_AT_END_SYSTOLE]
    last = p[SLOPE_AT_END_SYSTOLE] if early else p[SLOPE_AT_R]
    u = (phi if early else phi - p[END_SYSTOLE]) / width
    rest = 1.0 - u
    cubic = height * u * u * (3 - 2 * u) + first * width * u * rest**2 - last * width * u * u * rest
    slope = 6 * height / width * u * rest + first * rest * (1 - 3 * u) - last * u * (2 - 3 * u)
    return min(max(bottom + cubic, 0.0), 1.0 - 2.0**-53), slope


@inlined
def phase_at(p: FloatArray, t_s: float) -> Phase:
    """Compute model phase, its rate and standard deviation; see `dvf_ig.core.timing.phase_forecast`."""
    rr, phi = p[RR_S], p[PHI]
    target = p[CYCLES] + (t_s - p[R_S]) / rr
    caught = phi + p[CATCH_UP] * (t_s - p[PHASE_SINCE]) / rr
    unwrapped = max(phi, min(target, caught))
    rate = p[CATCH_UP] if caught < target else (1.0 if target > phi else 0.0)
    spread, timing = p[SPREAD] * max(0.0, t_s - p[R_S]) / rr, p[R_TIMING_S] / rr
    sigma = math.sqrt(spread**2 + timing**2 + (target - unwrapped) ** 2)
    model_phase, slope = _retimed(p, unwrapped - np.floor(unwrapped))
    return model_phase, slope * rate / rr, slope * sigma


@inlined
def status_at(p: FloatArray, t_s: float, finite: float) -> int:
    """Choose the status: FAULT before NO_POSE before NO_PHASE.

    Args:
        finite: a sum of all other numbers that must be finite.
    """
    if not math.isfinite(t_s + finite):
        return code.FAULT
    if t_s >= p[POSE_UNTIL]:
        return code.NO_POSE
    if not (p[PHASE_SINCE] <= t_s and t_s <= p[PHASE_UNTIL]):
        return code.NO_PHASE
    return code.OK


@inlined
def set_pose(out: FloatArray, at: int, pose: Columns) -> None:
    """Write the (3, 4) pose row by row, from `at` on."""
    for row in range(3):
        for column in range(4):
            out[at + 4 * row + column] = pose[column][row]


@kernel
def place_tick(packed: FloatArray, t_s: float, place: FloatArray) -> int:
    """Compute pose, model phase and their rates at one time.

    Args:
        packed: `packed_pose_and_phase`.
        place: (21,) pose, turn rate, velocity, model phase, its rate and standard deviation, at the offsets
            of this module; NaN if not known: the pose at NO_POSE, the phase at NO_PHASE, all at FAULT.
    Returns:
        status code.
    """
    place[:] = math.nan
    status = status_at(packed, t_s, 0.0)
    if status == code.FAULT:
        return status
    if t_s < packed[POSE_UNTIL]:
        pose = pose_at(packed, t_s)
        set_pose(place, MODEL_FROM_TRACKER, pose)
        for k in range(3):
            place[TURN_RATE + k], place[ORIGIN_VELOCITY + k] = pose[4][k], pose[5][k]
    if packed[PHASE_SINCE] <= t_s and t_s <= packed[PHASE_UNTIL]:
        phase = phase_at(packed, t_s)
        place[MODEL_PHASE], place[MODEL_PHASE_RATE], place[MODEL_PHASE_SIGMA] = phase
    return status
