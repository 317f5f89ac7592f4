"""A patient's model, fixtures and a device in the arrays of the servo's kernels."""

import math
from typing import Any, NamedTuple

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, Rigid
from dvf_ig.guidance.device import MM_PER_M, DeviceLimits
from dvf_ig.guidance.evaluator import Evaluator
from dvf_ig.guidance.fixtures import Fixtures
from dvf_ig.guidance.laws import Confinement, Gaussian
from dvf_ig.guidance.status import Status
from dvf_ig.guidance.supervision.hazards import (
    Hazard,
    Latch,
    Response,
    hazard_of,
    hazards_that_latch,
    hazards_with,
    withholding,
)
from dvf_ig.guidance.supervision.supervisor import (
    CLAMPS_WITHIN_S,
    FADE_S,
    FAST_FADE_S,
    LATCH_AFTER_S,
    REARM_AGE_S,
    REARM_BELOW_N,
    REARM_RISE_S,
    SLEW_SPEED_M_S,
    SLOW_SLEW_N_PER_S,
    RearmAnswer,
)
from dvf_ig.kernels.fixture_field import DEPTH, LAW
from dvf_ig.kernels.servo import supervision
from dvf_ig.kernels.servo import tick as kernel
from dvf_ig.kernels.servo.fixtures import FIXTURE_SIZE
from dvf_ig.kernels.servo.published import MAX_FIXTURES

from .options import ServoOptions

REARM_ANSWERS = {
    supervision.REARMED: RearmAnswer.ACCEPTED,
    supervision.NOT_LATCHED: RearmAnswer.NOT_LATCHED,
    supervision.NO_RECENT_STEP: RearmAnswer.NO_RECENT_STEP,
    supervision.HAZARD_ACTIVE: RearmAnswer.HAZARD_ACTIVE,
    supervision.FORCE_WANTED: RearmAnswer.FORCE_WANTED,
}


class Bound(NamedTuple):
    """Leading arguments of `servo_tick`."""

    linear: Any
    periodic: Any
    packed: FloatArray
    fixtures: FloatArray
    constants: FloatArray
    limits: FloatArray
    codes: Any


class TickConstants(NamedTuple):
    """Constants of a tick, in the order of `dvf_ig.kernels.servo.tick`; damping in N·s/mm."""

    period_s: float
    cap_n: float
    lead_s: float
    predict_tool: float
    speed_share: float
    relative_damping: float
    friction_n: float
    slow_mm_s: float
    largest_damping: float
    residual_limit_mj: float
    delay_ticks: int


class Scratch(NamedTuple):
    """Trailing arguments of `servo_tick` but for the record and the force."""

    memory: FloatArray
    first: FloatArray
    forces: FloatArray
    work: FloatArray
    order: FloatArray
    composed: FloatArray
    other: FloatArray
    vectors: FloatArray


def bind_fixtures(fixtures: Fixtures, device: DeviceLimits, options: ServoOptions, latency_s: float) -> Bound:
    """Everything that stays the same while a servo runs.

    Args:
        fixtures: on the patient's surface.
        device: its limits; the stiffness gives the slew limit, and no fixture exceeds its continuous force.
        options: of the servo.
        latency_s: of the device (`HapticDevice.latency_s`).
    Raises:
        InvalidInputError: a path among the fixtures, too many of them, or a larger force than the device's.
    """
    device.require_force("the largest force of the fixtures", fixtures.options.joint_cap_n)
    parts = [part for part in fixtures.parts if isinstance(part, Evaluator)]
    if len(parts) < len(fixtures.parts):
        raise InvalidInputError(
            "the servo renders fixtures on the model's surface; one of these guides to a path: leave it out"
        )
    if len(parts) > MAX_FIXTURES:
        raise InvalidInputError(f"{len(parts)} fixtures given; the servo renders up to {MAX_FIXTURES}")
    rows = [_packed(part) for part in parts]
    packed = np.zeros((len(rows), max(len(row) for row in rows)))
    for i, row in enumerate(rows):
        packed[i, : len(row)] = row
    nothing = np.zeros((0, 4, 4, 4), dtype=np.float32)
    linear = [part.coefficients for part in parts if part.blend != "periodic"]
    periodic = [part.coefficients for part in parts if part.blend == "periodic"]
    constants = np.zeros((FIXTURE_SIZE, len(rows)))
    for i, part in enumerate(parts):
        guiding, confining = isinstance(part.law, Gaussian), isinstance(part.law, Confinement)
        constants[:, i] = (
            part.law.cap_n,
            0.0 if guiding else 1.0,
            packed[i, LAW + 1],
            packed[i, DEPTH],
            1.0 if guiding else 0.0,
            0.0 if guiding else (1.0 if confining else -1.0),
        )
    return Bound(
        linear[0] if linear else nothing,
        periodic[0] if periodic else nothing,
        packed,
        constants,
        np.array(tick_constants(fixtures, options, latency_s), dtype=np.float64),
        supervisor_limits(device),
        hazard_codes(fixtures.walls),
    )


def new_scratch(fixtures: int) -> Scratch:
    """Memory before the first tick, and scratch arrays, for so many fixtures."""
    sizes = kernel.scratch_sizes(fixtures)
    memory = np.zeros(kernel.MEMORY_SIZE)
    supervision.start_supervision(memory[kernel.SUPERVISION : kernel.TOOL])
    return Scratch(memory, *(np.zeros(sizes[name]) for name in Scratch._fields[1:]))


def _packed(part: Evaluator) -> FloatArray:
    frame = part.model.frame
    return part.kernel_arguments(Rigid.identity(frame, frame))[1]


def tick_constants(fixtures: Fixtures, options: ServoOptions, latency_s: float) -> TickConstants:
    """A force is held for a period: half of it after it was sent is the middle of its effect."""
    period_s = options.period_ns * 1e-9
    forward = options.feed_forward
    return TickConstants(
        period_s=period_s,
        cap_n=fixtures.options.joint_cap_n,
        lead_s=latency_s + 0.5 * period_s,
        predict_tool=float(options.predict_tool),
        speed_share=1.0 - math.exp(-2.0 * math.pi * options.speed_cutoff_hz * period_s),
        relative_damping=forward.damping_n_s_per_m / MM_PER_M,
        friction_n=forward.friction_n,
        slow_mm_s=forward.slow_mm_s,
        largest_damping=options.largest_damping_n_s_per_m / MM_PER_M,
        residual_limit_mj=options.residual_limit_mj,
        delay_ticks=round(latency_s / period_s),
    )


def supervisor_limits(device: DeviceLimits) -> FloatArray:
    """(LIMITS_SIZE,) constants of the supervisor, at the offsets of `dvf_ig.kernels.servo.supervision`."""
    limits = np.zeros(supervision.LIMITS_SIZE)
    limits[supervision.FADE_S], limits[supervision.FAST_FADE_S] = FADE_S, FAST_FADE_S
    limits[supervision.SLEW] = device.stiffness_n_per_m * SLEW_SPEED_M_S
    limits[supervision.SLOW_SLEW] = SLOW_SLEW_N_PER_S
    limits[supervision.LATCH_AFTER_S] = LATCH_AFTER_S
    limits[supervision.CLAMPS_WITHIN_S] = CLAMPS_WITHIN_S
    limits[supervision.REARM_BELOW_N], limits[supervision.REARM_RISE_S] = REARM_BELOW_N, REARM_RISE_S
    limits[supervision.REARM_AGE_S] = REARM_AGE_S
    return limits


def hazard_codes(walls: bool) -> Any:
    """The hazards' bits as the kernels need them.

    Args:
        walls: a forbidden region is among the fixtures (`withholding`).
    """
    codes = np.zeros(kernel.CODES_SIZE, dtype=np.int64)
    codes[supervision.FADING] = withholding(walls)
    codes[supervision.FAST] = hazards_with(Response.FAST_FADE)
    codes[supervision.AT_ONCE] = hazards_with(Response.NO_FORCE)
    codes[supervision.SLOWING] = hazards_with(Response.SLOW)
    codes[supervision.LATCH_LATE] = hazards_that_latch(Latch.AFTER_1_S)
    codes[supervision.LATCH_AT_ONCE] = hazards_that_latch(Latch.AT_ONCE)
    codes[supervision.NOT_FINITE] = Hazard.NOT_FINITE
    codes[supervision.FORCE_CLAMPED] = Hazard.FORCE_CLAMPED
    for status in Status:
        codes[kernel.OF_STATUS + status] = hazard_of(status)
    codes[kernel.SESSION_SILENT] = Hazard.SESSION_SILENT
    codes[kernel.DEVICE_LOST] = Hazard.DEVICE_LOST
    codes[kernel.ENERGY] = Hazard.ENERGY
    codes[kernel.MISSED_DEADLINES] = Hazard.MISSED_DEADLINES
    return codes
