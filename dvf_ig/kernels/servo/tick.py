"""One tick of the servo: position in, force out, everything in between, without Python.

    validate → pose and phase at the moment at which the force is felt → fixtures → compose → relative damping
    → passivity → saturate → supervise (fade, slew, latch) → ceiling of any force → output

`tests/oracles/readable_tick.py` is the readable form.
"""

import math
from typing import Any

from dvf_ig.core import FloatArray
from dvf_ig.kernels import status as code
from dvf_ig.kernels.compiled import inlined, separate
from dvf_ig.kernels.laws import LARGEST_FORCE_N, direction_certainty

from . import supervision
from .borrowed import borrowed, borrowed_from
from .fixtures import fixtures_force
from .lever import force_on_hand, force_on_tip, lever_in_range, softening, tip_of_hand
from .passivity import control, mean_velocity, note_sent, observe
from .phase_loss import cross_to_walls
from .supervision import supervise
from .tissue import tissue_force


@inlined
def _place_in_tracker(
    m: Any, settings: Any, inputs: Any, xyz_device: FloatArray, dt_s: float, place: FloatArray
) -> bool:
    """Tool in the tracker frame and its filtered speed, into the memory; whether it is finite."""
    pose = inputs.tracker_from_device
    for k in range(3):
        place[k] = (
            pose[k, 0] * xyz_device[0] + pose[k, 1] * xyz_device[1] + pose[k, 2] * xyz_device[2] + pose[k, 3]
        )
    if settings.tool.length_mm > 0.0:
        tip_of_hand(m, settings.tool, place)
    finite = True
    for k in range(3):
        x = place[k]
        finite = finite and math.isfinite(x)
        if m.tool_known != 0 and dt_s > 0.0:
            now = (x - m.tool_mm[k]) / dt_s
            m.tool_mm_s[k] += settings.speed_share * (now - m.tool_mm_s[k])
        m.tool_mm[k] = x
    m.tool_known = 1 if finite else 0
    if not finite:
        for k in range(3):
            m.tool_mm_s[k] = 0.0
    return finite


@inlined
def _relative_damping(settings: Any, m: Any, sample: Any, surface: FloatArray, out: FloatArray) -> float:
    """Surface velocity (3,) along the normal; `dvf_ig.guidance.FeedForward` added to `out`; its speed."""
    gx, gy, gz = sample.gradient[0], sample.gradient[1], sample.gradient[2]
    norm = math.sqrt(gx * gx + gy * gy + gz * gz)
    certainty = direction_certainty(norm)
    if not certainty > 0.0:
        return math.nan
    nx, ny, nz = gx / norm, gy / norm, gz / norm
    speed: float = -sample.distance_rate_mm_s / norm
    surface[0], surface[1], surface[2] = speed * nx, speed * ny, speed * nz
    push = 0.0
    if settings.friction_n > 0.0:
        push = settings.friction_n * math.tanh(speed / settings.slow_mm_s)
    along = m.tool_mm_s[0] * nx + m.tool_mm_s[1] * ny + m.tool_mm_s[2] * nz
    push = certainty * (push - settings.relative_damping * (along - speed))
    out[0] += push * nx
    out[1] += push * ny
    out[2] += push * nz
    return speed


@inlined
def _saturate(v: FloatArray, cap_n: float) -> None:
    length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if length > cap_n:
        for k in range(3):
            v[k] *= cap_n / length


@inlined
def _within_ceiling(force: FloatArray) -> None:
    """Shorten a force to LARGEST_FORCE_N, in place, whatever made it; zero if it is no finite number."""
    length = math.sqrt(force[0] * force[0] + force[1] * force[1] + force[2] * force[2])
    if not length <= LARGEST_FORCE_N:
        for k in range(3):
            force[k] = force[k] * (LARGEST_FORCE_N / length) if math.isfinite(length) else 0.0


@separate
def servo_tick(
    bound_at: Any,
    scratch_at: Any,
    inputs: Any,
    xyz_device: FloatArray,
    device_status: int,
    clock_s: float,
    active: int,
    force_device: FloatArray,
) -> None:
    """One tick; its record is `scratch.row`.

    Args:
        bound_at, scratch_at: addresses (`placed`) of `Bound` and `Scratch`.
        inputs: INPUTS, what the session published.
        xyz_device: (3,) mm, device frame; device_status: not 0 where the device did not answer.
        clock_s: monotonic clock at which the position was read.
        active: bits of the hazards that the loop met.
        force_device: (3,) N to send, device frame.
    """
    bound, scratch = borrowed_from(bound_at), borrowed_from(scratch_at)
    xyz_device, force_device = borrowed(xyz_device), borrowed(force_device)
    settings, m, sample = bound.settings[0], scratch.memory[0], scratch.sample[0]
    composed, row, hazards = scratch.composed[0], scratch.row[0], bound.settings[0].hazards
    vectors = scratch.vectors
    xyz, field, target, surface, speed = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4]
    t_s = clock_s - inputs.clock_offset_s
    dt_s = clock_s - m.last_tick_s if math.isfinite(m.last_tick_s) else settings.period_s
    m.last_tick_s = clock_s
    active |= inputs.hazards
    status = inputs.tool_status
    if device_status != 0:
        active |= hazards.device_lost
        status = code.STALE_TOOL
        m.tool_known = 0
    elif not _place_in_tracker(m, settings, inputs, xyz_device, dt_s, vectors[7]):
        status = code.FAULT
    if not clock_s <= inputs.valid_until_s:
        active |= hazards.session_silent
        status = code.NO_POSE if status == code.OK else status
    levered = settings.tool.length_mm > 0.0
    if levered and status == code.OK and not lever_in_range(m):
        status = code.OUT_OF_VOLUME
    if status == code.OK and active & hazards.no_phase:
        status = code.NO_PHASE
    for k in range(3):
        speed[k] = m.tool_mm_s[k]
        xyz[k] = m.tool_mm[k] + settings.predict_tool * settings.lead_s * speed[k]
        surface[k] = 0.0
    felt_s = t_s + settings.lead_s
    if bound.tissue[0].felt != 0:
        status = tissue_force(bound, scratch, inputs, felt_s, xyz, status)
    else:
        status = fixtures_force(bound_at, scratch_at, inputs, felt_s, xyz, status)
        if status != code.OK or m.worst_share > 0.0:
            status = cross_to_walls(bound_at, scratch_at, inputs, felt_s, xyz, status, dt_s)
    evaluated = math.isfinite(sample.distance_mm)
    surface_speed = math.nan
    for k in range(3):
        xyz[k] = m.tool_mm[k]
        field[k] = composed.forbidden_n[k] + composed.guidance_n[k]
        target[k] = field[k]
    if evaluated:
        surface_speed = _relative_damping(settings, m, sample, surface, target)
    parts = sample.parts if m.worst_share == 0.0 and status == code.OK else 0
    mean_velocity(parts, scratch.part_n, scratch.part_mm_s, surface)
    largest_damping = settings.largest_damping
    if levered:
        share = softening(m)
        largest_damping *= share
        for k in range(3):
            field[k], target[k] = share * field[k], share * target[k]
            for i in range(parts):
                scratch.part_n[i, k] *= share
    met = status == code.FAULT or status == code.OUT_OF_VOLUME or status == code.UNSEEN
    if met or not active & hazards.fading:
        # otherwise who published why no force is given has said it
        active |= hazards.of_status[status]
    s, p = m.supervision, m.passivity
    if device_status == 0 and m.tool_known != 0:
        following = s.state <= supervision.DEGRADED and s.slow == 0
        part_n, part_mm_s = scratch.part_n, scratch.part_mm_s
        observe(p, xyz, field, dt_s, settings.delay_ticks, following, parts, part_n, part_mm_s)
        if evaluated:
            control(p, speed, surface, settings.period_s, largest_damping, target)
    else:
        p.started = 0
    if p.residual_mj > settings.residual_limit_mj:
        active |= hazards.energy
    if levered:
        force_on_hand(m, target)
    _saturate(target, settings.cap_n)
    supervise(s, settings.limits, hazards, clock_s, target, active)
    if s.state == supervision.LATCHED:
        p.residual_mj = 0.0
    if not math.isfinite(s.sent_n[0] + s.sent_n[1] + s.sent_n[2]):
        s.sent_n[0] = s.sent_n[1] = s.sent_n[2] = 0.0
    if levered:
        force_on_tip(m, s.sent_n, vectors[8])
        note_sent(p, vectors[8])
    else:
        note_sent(p, s.sent_n)
    turn = inputs.tracker_from_device
    for k in range(3):
        force_device[k] = turn[0, k] * s.sent_n[0] + turn[1, k] * s.sent_n[1] + turn[2, k] * s.sent_n[2]
    _within_ceiling(force_device)
    for k in range(3):
        row.xyz_mm[k], row.field_n[k], row.wanted_n[k] = xyz[k], field[k], target[k]
        row.gradient[k] = sample.gradient[k]
    row.t_s, row.status, row.conflict = t_s, status, composed.conflict
    row.distance_mm, row.rate_mm_per_cycle = sample.distance_mm, sample.rate_mm_per_cycle
    row.sigma_mm, row.surface_mm_s = sample.sigma_mm, surface_speed
    _record_memory(row, s, p)


@inlined
def _record_memory(row: Any, s: Any, p: Any) -> None:
    """State of supervisor and passivity observer after the tick."""
    for k in range(3):
        row.sent_n[k] = s.sent_n[k]
    row.state, row.scale, row.hazards, row.cause, row.clamped = (
        s.state,
        s.scale,
        s.hazards,
        s.cause,
        s.clamped,
    )
    row.residual_mj, row.given_mj = p.residual_mj, p.given_mj
    row.by_surface_mj, row.controller_damping = p.by_surface_mj, p.damping


@separate
def withhold(bound: Any, scratch: Any, clock_s: float) -> None:
    """Latch, in memory and record, after a tick whose force was not sent or was followed by zero."""
    settings, row = bound.settings[0], scratch.row[0]
    s, p = scratch.memory[0].supervision, scratch.memory[0].passivity
    active = s.hazards | settings.hazards.missed_deadlines
    supervise(s, settings.limits, settings.hazards, clock_s, row.wanted_n, active)
    p.residual_mj = 0.0
    p.sent_count -= 1
    note_sent(p, s.sent_n)
    _record_memory(row, s, p)
