"""One tick of the servo: position in, force out, everything in between, without Python.

    validate → pose and phase at the moment at which the force is felt → fixtures → compose → relative damping
    → passivity → saturate → supervise (fade, slew, latch) → ceiling of any force → output

`dvf_ig.guidance.servo.twin` is the readable form.
"""

import math
from typing import Any

from numpy.typing import NDArray

from dvf_ig.core import FloatArray
from dvf_ig.kernels import status as code
from dvf_ig.kernels.compiled import inlined, kernel
from dvf_ig.kernels.composition import COMPOSED_SIZE, CONFLICT, work_size
from dvf_ig.kernels.laws import LARGEST_FORCE_N, direction_certainty
from dvf_ig.kernels.pose_and_phase import DISTANCE_RATE, DISTANCE_SIGMA, GUIDED_SIZE

from . import passivity, supervision
from .fixtures import LOSS_SIZE, WORST_SHARE, fixtures_force
from .passivity import control, note_sent, observe
from .phase_loss import cross_to_walls
from .published import CLOCK_OFFSET_S, HAZARDS, TOOL_STATUS, TRACKER_FROM_DEVICE, VALID_UNTIL_S
from .record import (
    DISTANCE_MM,
    FIELD_N,
    IN_CONFLICT,
    SENT_N,
    SIGMA_MM,
    STATUS,
    SURFACE_MM_S,
    T_S,
    WANTED_N,
    XYZ_MM,
    record_energy,
    record_supervision,
)
from .supervision import supervise

# Offsets in the constants of a servo.
PERIOD_S = 0
CAP_N = 1
LEAD_S = 2
PREDICT_TOOL = 3
SPEED_SHARE = 4
RELATIVE_DAMPING = 5
FRICTION_N = 6
SLOW_MM_S = 7
LARGEST_DAMPING = 8
RESIDUAL_LIMIT_MJ = 9
DELAY_TICKS = 10
CONSTANTS_SIZE = 11

# Offsets in the hazard codes, after the supervisor's masks.
OF_STATUS = supervision.MASKS_SIZE
SESSION_SILENT = OF_STATUS + 6
DEVICE_LOST = SESSION_SILENT + 1
ENERGY = DEVICE_LOST + 1
MISSED_DEADLINES = ENERGY + 1
CODES_SIZE = MISSED_DEADLINES + 1

# Offsets in a tick's memory.
SUPERVISION = passivity.MEMORY_SIZE
TOOL = SUPERVISION + supervision.MEMORY_SIZE
TOOL_XYZ = TOOL
TOOL_SPEED = TOOL + 3
TOOL_KNOWN = TOOL + 6
LAST_TICK_S = TOOL + 7
PHASE_LOSS = TOOL + 8
MEMORY_SIZE = PHASE_LOSS + LOSS_SIZE


def scratch_sizes(fixtures: int) -> dict[str, Any]:
    """Shapes of a tick's scratch arrays for so many fixtures."""
    return {
        "forces": (fixtures, 3),
        "first": (GUIDED_SIZE,),
        "work": work_size(fixtures),
        "order": (fixtures,),
        "composed": (COMPOSED_SIZE,),
        "other": (COMPOSED_SIZE,),
        "vectors": (5, 3),
    }


@inlined
def _place_in_tracker(
    m: FloatArray, c: FloatArray, inputs: FloatArray, xyz_device: FloatArray, dt_s: float
) -> bool:
    """Tool in the tracker frame and its filtered speed, into the memory; whether it is finite."""
    t = TRACKER_FROM_DEVICE
    finite = True
    for k in range(3):
        x = (
            inputs[t + 4 * k] * xyz_device[0]
            + inputs[t + 4 * k + 1] * xyz_device[1]
            + inputs[t + 4 * k + 2] * xyz_device[2]
            + inputs[t + 4 * k + 3]
        )
        finite = finite and math.isfinite(x)
        if m[TOOL_KNOWN] != 0.0 and dt_s > 0.0:
            now = (x - m[TOOL_XYZ + k]) / dt_s
            m[TOOL_SPEED + k] += c[SPEED_SHARE] * (now - m[TOOL_SPEED + k])
        m[TOOL_XYZ + k] = x
    m[TOOL_KNOWN] = 1.0 if finite else 0.0
    if not finite:
        for k in range(3):
            m[TOOL_SPEED + k] = 0.0
    return finite


@inlined
def _relative_damping(
    c: FloatArray, m: FloatArray, first: FloatArray, surface: FloatArray, out: FloatArray
) -> float:
    """Surface velocity (3,) along the normal; `dvf_ig.guidance.FeedForward` added to `out`; its speed."""
    gx, gy, gz = first[4], first[5], first[6]
    norm = math.sqrt(gx * gx + gy * gy + gz * gz)
    certainty = direction_certainty(norm)
    if not certainty > 0.0:
        return math.nan
    nx, ny, nz = gx / norm, gy / norm, gz / norm
    speed: float = -first[DISTANCE_RATE] / norm
    surface[0], surface[1], surface[2] = speed * nx, speed * ny, speed * nz
    push = 0.0
    if c[FRICTION_N] > 0.0:
        push = c[FRICTION_N] * math.tanh(speed / c[SLOW_MM_S])
    along = m[TOOL_SPEED] * nx + m[TOOL_SPEED + 1] * ny + m[TOOL_SPEED + 2] * nz
    push = certainty * (push - c[RELATIVE_DAMPING] * (along - speed))
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


@inlined
def _to_device(inputs: FloatArray, sent: FloatArray, force_device: FloatArray) -> None:
    """A force of the tracker's frame in the device's."""
    for k in range(3):
        force_device[k] = (
            inputs[TRACKER_FROM_DEVICE + k] * sent[0]
            + inputs[TRACKER_FROM_DEVICE + 4 + k] * sent[1]
            + inputs[TRACKER_FROM_DEVICE + 8 + k] * sent[2]
        )


@inlined
def servo_tick(
    linear: NDArray[Any],
    periodic: NDArray[Any],
    packed: FloatArray,
    fixtures: FloatArray,
    c: FloatArray,
    limits: FloatArray,
    codes: Any,
    inputs: FloatArray,
    xyz_device: FloatArray,
    device_status: int,
    clock_s: float,
    found: int,
    m: FloatArray,
    first: FloatArray,
    forces: FloatArray,
    work: FloatArray,
    order: FloatArray,
    composed: FloatArray,
    other: FloatArray,
    vectors: FloatArray,
    row: FloatArray,
    force_device: FloatArray,
) -> None:
    """One tick.

    Args:
        linear, periodic: (n, cx, cy, cz) coefficients of the two kinds of blend; (0, …) of one not used.
        packed: (k, p) fixtures (`packed_fixture`), written to.
        fixtures: (6, k) their constants; c: constants of the servo; limits, codes: of the supervisor.
        inputs: what the session published; writable.
        xyz_device: (3,) mm, device frame; device_status: not 0 where the device did not answer.
        clock_s: monotonic clock at which the position was read.
        found: hazard bits that the loop found.
        m: memory; first, forces, work, order, composed, other, vectors: scratch (`scratch_sizes`).
        row: (30,) the record of this tick.
        force_device: (3,) N to send, device frame.
    """
    t_s, loss = clock_s - inputs[CLOCK_OFFSET_S], m[PHASE_LOSS:]
    dt_s = clock_s - m[LAST_TICK_S] if m[LAST_TICK_S] != 0.0 else c[PERIOD_S]
    m[LAST_TICK_S] = clock_s
    hazards = found | int(inputs[HAZARDS])
    xyz, field, wanted, surface, speed = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4]
    status = int(inputs[TOOL_STATUS])
    if device_status != 0:
        hazards |= codes[DEVICE_LOST]
        status = code.STALE_TOOL
        m[TOOL_KNOWN] = 0.0
    elif not _place_in_tracker(m, c, inputs, xyz_device, dt_s):
        status = code.FAULT
    if not clock_s <= inputs[VALID_UNTIL_S]:
        hazards |= codes[SESSION_SILENT]
        status = code.NO_POSE if status == code.OK else status
    if status == code.OK and hazards & codes[OF_STATUS + code.NO_PHASE]:
        status = code.NO_PHASE
    for k in range(3):
        speed[k] = m[TOOL_SPEED + k]
        xyz[k] = m[TOOL_XYZ + k] + c[PREDICT_TOOL] * c[LEAD_S] * speed[k]
        surface[k] = 0.0
    status = fixtures_force(
        linear,
        periodic,
        packed,
        fixtures,
        c[CAP_N],
        inputs,
        t_s + c[LEAD_S],
        xyz,
        status,
        loss,
        first,
        forces,
        work,
        order,
        composed,
    )
    if status != code.OK or loss[WORST_SHARE] > 0.0:
        status = cross_to_walls(
            linear,
            periodic,
            packed,
            fixtures,
            c[CAP_N],
            inputs,
            t_s + c[LEAD_S],
            xyz,
            status,
            dt_s / limits[supervision.FADE_S],
            loss,
            first,
            forces,
            work,
            order,
            composed,
            other,
        )
    evaluated = math.isfinite(first[3])
    surface_speed = math.nan
    for k in range(3):
        xyz[k] = m[TOOL_XYZ + k]
        field[k] = composed[k] + composed[3 + k]
        wanted[k] = field[k]
    if evaluated:
        surface_speed = _relative_damping(c, m, first, surface, wanted)
    hazards |= codes[OF_STATUS + status]
    supervisor = m[SUPERVISION:TOOL]
    if device_status == 0 and m[TOOL_KNOWN] != 0.0:
        following = (
            supervisor[supervision.STATE] <= supervision.DEGRADED and supervisor[supervision.SLOW] == 0.0
        )
        observe(m, xyz, field, dt_s, int(c[DELAY_TICKS]), following)
        if evaluated:
            control(m, speed, surface, c[PERIOD_S], c[LARGEST_DAMPING], wanted)
    else:
        m[passivity.STARTED] = 0.0
    if m[passivity.RESIDUAL] > c[RESIDUAL_LIMIT_MJ]:
        hazards |= codes[ENERGY]
    _saturate(wanted, c[CAP_N])
    supervise(supervisor, limits, codes, clock_s, wanted, hazards)
    if supervisor[supervision.STATE] == supervision.LATCHED:
        m[passivity.RESIDUAL] = 0.0
    sent = supervisor[supervision.SENT : supervision.SENT + 3]
    if not math.isfinite(sent[0] + sent[1] + sent[2]):
        sent[0] = sent[1] = sent[2] = 0.0
    note_sent(m, sent)
    _to_device(inputs, sent, force_device)
    _within_ceiling(force_device)
    for k in range(3):
        row[XYZ_MM + k], row[FIELD_N + k], row[WANTED_N + k] = xyz[k], field[k], wanted[k]
        row[SENT_N + k] = sent[k]
    row[T_S], row[STATUS], row[IN_CONFLICT] = t_s, status, composed[CONFLICT]
    row[DISTANCE_MM], row[SIGMA_MM], row[SURFACE_MM_S] = first[3], first[DISTANCE_SIGMA], surface_speed
    record_supervision(row, supervisor)
    record_energy(row, m)


@kernel
def withhold(m: FloatArray, limits: FloatArray, codes: Any, clock_s: float, row: FloatArray) -> None:
    """Latch, in memory and record, after a tick whose force was not sent or was followed by zero.

    Args:
        m, limits, codes, clock_s, row: of the tick.
    """
    supervisor = m[SUPERVISION:TOOL]
    hazards = int(supervisor[supervision.HAZARDS]) | codes[MISSED_DEADLINES]
    supervise(supervisor, limits, codes, clock_s, row[WANTED_N : WANTED_N + 3], hazards)
    m[passivity.RESIDUAL] = 0.0
    m[passivity.SENT_COUNT] -= 1.0
    note_sent(m, supervisor[supervision.SENT : supervision.SENT + 3])
    for k in range(3):
        row[SENT_N + k] = supervisor[supervision.SENT + k]
    record_supervision(row, supervisor)
    record_energy(row, m)


unpacked_tick: Any = servo_tick
"""The same, for callers that unpack two tuples into its arguments, which type checkers do not follow."""
