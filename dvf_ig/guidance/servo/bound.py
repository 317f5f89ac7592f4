"""A patient's model, fixtures and a device as arguments of the servo's kernels."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, InvalidInputError, Rigid
from dvf_ig.guidance.device import MM_PER_M, DeviceLimits
from dvf_ig.guidance.evaluator import Evaluator
from dvf_ig.guidance.fixtures import Fixtures
from dvf_ig.guidance.laws import Confinement, Gaussian
from dvf_ig.guidance.places import Status
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
from dvf_ig.guidance.targets import PathFixture
from dvf_ig.guidance.tissue import Feel
from dvf_ig.kernels.fixture_field import BLEND_PATH, DEPTH, LAW, packed_fixture
from dvf_ig.kernels.servo import supervision
from dvf_ig.kernels.servo.layout import MAX_FIXTURES, SETTINGS, TISSUE, Bound

from .options import SPEED_CUTOFF_HZ, ServoOptions

REARM_ANSWERS = {
    supervision.REARMED: RearmAnswer.ACCEPTED,
    supervision.NOT_LATCHED: RearmAnswer.NOT_LATCHED,
    supervision.NO_RECENT_STEP: RearmAnswer.NO_RECENT_STEP,
    supervision.HAZARD_ACTIVE: RearmAnswer.HAZARD_ACTIVE,
    supervision.FORCE_WANTED: RearmAnswer.FORCE_WANTED,
}


class TickConstants(NamedTuple):
    """Constants of a tick, as in `SETTINGS`; damping in N·s/mm."""

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


def bind_fixtures(
    fixtures: Fixtures,
    device: DeviceLimits,
    options: ServoOptions,
    latency_s: float,
    *,
    in_hand: bool = False,
) -> Bound:
    """Everything that stays the same while a servo runs.

    Args:
        fixtures: on the patient's surface, on further structures, or to a path.
        device: its limits; the stiffness gives the slew limit, and no fixture exceeds its continuous force.
        options: of the servo.
        latency_s: of the device (`HapticDevice.latency_s`).
        in_hand: its position is that of the hand, which holds the tip through a fulcrum if there is one.
    Raises:
        InvalidInputError: too many fixtures, or a larger force than the device's.
    """
    device.require_force("the largest force of the fixtures", fixtures.options.joint_cap_n)
    parts = fixtures.parts
    if len(parts) > MAX_FIXTURES:
        raise InvalidInputError(f"{len(parts)} fixtures given; the servo renders up to {MAX_FIXTURES}")
    rows = [_packed(part, fixtures) for part in parts]
    packed = np.zeros((len(rows), max(len(row) for row in rows)))
    for i, row in enumerate(rows):
        packed[i, : len(row)] = row
    nothing = np.zeros((0, 4, 4, 4), dtype=np.float32)
    structures, begins = _structures(fixtures)
    placed = zip(parts, begins, strict=True)
    surfaces = [part for part, begin in placed if isinstance(part, Evaluator) and begin is None]
    linear = [part.coefficients for part in surfaces if part.blend != "periodic"]
    periodic = [part.coefficients for part in surfaces if part.blend == "periodic"]
    settings = np.zeros(1, SETTINGS)
    first = parts[0]
    inward = 0.0 if isinstance(first, PathFixture) else (-1.0 if isinstance(first.law, Confinement) else 1.0)
    settings["tool"] = fixtures.options.tool.packed(in_hand=in_hand, inward=inward)
    for name, value in tick_constants(fixtures, options, latency_s)._asdict().items():
        settings[name] = value
    set_limits(settings["limits"], device)
    set_hazards(settings["hazards"], fixtures.walls)
    points, times = _set_fixtures(settings["fixtures"][0], packed, fixtures, begins)
    return Bound(
        linear[0] if linear else nothing,
        periodic[0] if periodic else nothing,
        packed,
        structures,
        np.ascontiguousarray(points.T),
        times,
        np.zeros((8, settings["fixtures"]["path_points"].max())),
        settings,
        *bound_feel(options.feel),
    )


def bound_feel(feel: Feel | None) -> tuple[Any, NDArray[np.float32], NDArray[np.float32]]:
    """(1,) TISSUE, motion and properties; nothing is felt without them."""
    tissue = np.zeros(1, TISSUE)
    if feel is None:
        return tissue, np.zeros((1, 4, 4, 16), dtype=np.float32), np.zeros((2, 2, 2, 4), dtype=np.float32)
    first, grid = feel.tissue.motion[0], feel.tissue.labels.grid
    tissue["felt"], tissue["stick_n_per_mm"] = 1, feel.stick_n_per_mm
    tissue["warp_origin_mm"], tissue["warp_per_mm"] = first.origin_mm, 1.0 / first.knot_mm
    tissue["label_origin_mm"], tissue["label_per_mm"] = grid.origin_mm, 1.0 / grid.spacing_mm[0]
    count = len(first.coefficients)
    motion = [warp.coefficients.reshape(count, count, 4 * count) for warp in feel.tissue.motion]
    return tissue, np.stack(motion), np.array(feel.properties)


def _structures(fixtures: Fixtures) -> tuple[NDArray[np.float32], list[int | None]]:
    """Coefficients of all further structures, and where each fixture's begin; None if it is not on one."""
    parts: list[NDArray[np.float32]] = []
    begins: list[int | None] = []
    placed: dict[tuple[int, bool], int] = {}
    size = 0
    for part, one in zip(fixtures.parts, fixtures.options.fixtures, strict=True):
        if one.structure is None or not isinstance(part, Evaluator):
            begins.append(None)
            continue
        key = (id(one.structure), part.blend == "periodic")
        if key not in placed:
            placed[key] = size
            parts.append(part.coefficients.ravel())
            size += part.coefficients.size
        begins.append(placed[key])
    return np.concatenate([np.zeros(0, dtype=np.float32), *parts]), begins


def _set_fixtures(
    of: Any, packed: FloatArray, fixtures: Fixtures, begins: list[int | None]
) -> tuple[FloatArray, FloatArray]:
    """Fill FIXTURES; all paths' points (m, 3) and phase times."""
    points, times = np.zeros((0, 3)), np.zeros(0)
    of["walls"], of["far_outside"][: len(begins)] = fixtures.walls, fixtures.far_outside
    of["first"] = of["first_linear"] = MAX_FIXTURES
    for i, (part, begin) in enumerate(zip(fixtures.parts, begins, strict=True)):
        guiding, confining = isinstance(part.law, Gaussian), isinstance(part.law, Confinement)
        of["cap_n"][i], of["forbidden"][i] = part.law.cap_n, not guiding
        of["base_width"][i], of["base_depth_mm"][i] = packed[i, LAW + 1], packed[i, DEPTH]
        if isinstance(part, PathFixture):
            target = part.target
            of["apart"][i] = 1
            of["path_phases"][i], of["path_points"][i] = target.points_mm.shape[:2]
            of["path_first_point"][i], of["path_first_time"][i] = len(points), len(times)
            points = np.concatenate([points, target.points_mm.reshape(-1, 3)])
            times = np.append(times, 0.0 if target.timing is None else target.timing.fractions)
            continue
        if begin is not None:
            of["apart"][i], of["structure_begin"][i] = 1, begin
            of["structure_shape"][i] = part.coefficients.shape
        else:
            of["first"] = min(of["first"], i)
            if part.blend != "periodic":
                of["first_linear"] = min(of["first_linear"], i)
        of["widen_width"][i] = 1.0 if guiding else 0.0
        of["widen_depth"][i] = 0.0 if guiding else (1.0 if confining else -1.0)
    of["others"] = of["apart"].sum()
    return points, times


def _packed(part: Evaluator | PathFixture, fixtures: Fixtures) -> FloatArray:
    model = fixtures.model
    still = Rigid.identity(model.frame, model.frame)
    if isinstance(part, Evaluator):
        return part.kernel_arguments(still)[1]
    timing = model.timing if part.target.timing is None else part.target.timing
    origin_mm, knot_mm, fractions = model.origin_mm, model.knot_spacing_mm, timing.fractions
    powers, matrix = np.zeros((0, 4, 4)), still.matrix[:3]
    return packed_fixture(
        origin_mm, knot_mm, fractions, powers, part.law.parameters, BLEND_PATH, None, matrix
    )


def tick_constants(fixtures: Fixtures, options: ServoOptions, latency_s: float) -> TickConstants:
    """A force is held for a period: half of it after it was sent is the middle of its effect."""
    period_s = options.period_ns * 1e-9
    forward = options.feed_forward
    return TickConstants(
        period_s=period_s,
        cap_n=fixtures.options.joint_cap_n,
        lead_s=latency_s + 0.5 * period_s,
        predict_tool=float(options.predict_tool),
        speed_share=1.0 - math.exp(-2.0 * math.pi * SPEED_CUTOFF_HZ * period_s),
        relative_damping=forward.damping_n_s_per_m / MM_PER_M,
        friction_n=forward.friction_n,
        slow_mm_s=forward.slow_mm_s,
        largest_damping=options.largest_damping_n_s_per_m / MM_PER_M,
        residual_limit_mj=options.residual_limit_mj,
        delay_ticks=round(latency_s / period_s),
    )


def set_limits(limits: Any, device: DeviceLimits) -> None:
    """Fill (1,) LIMITS of the supervisor."""
    limits["fade_s"], limits["fast_fade_s"] = FADE_S, FAST_FADE_S
    limits["slew_n_per_s"] = device.stiffness_n_per_m * SLEW_SPEED_M_S
    limits["slow_slew_n_per_s"] = SLOW_SLEW_N_PER_S
    limits["latch_after_s"], limits["clamps_within_s"] = LATCH_AFTER_S, CLAMPS_WITHIN_S
    limits["rearm_below_n"], limits["rearm_rise_s"] = REARM_BELOW_N, REARM_RISE_S
    limits["rearm_age_s"] = REARM_AGE_S


def set_hazards(hazards: Any, walls: bool) -> None:
    """Fill (1,) HAZARDS.

    Args:
        walls: a forbidden region is among the fixtures (`withholding`).
    """
    hazards["fading"] = withholding(walls)
    hazards["fast"] = hazards_with(Response.FAST_FADE)
    hazards["at_once"] = hazards_with(Response.NO_FORCE)
    hazards["slowing"] = hazards_with(Response.SLOW)
    hazards["latch_late"] = hazards_that_latch(Latch.AFTER_1_S)
    hazards["latch_at_once"] = hazards_that_latch(Latch.AT_ONCE)
    hazards["of_status"][0, list(Status)] = [hazard_of(status) for status in Status]
    for one in (
        Hazard.NOT_FINITE,
        Hazard.FORCE_CLAMPED,
        Hazard.NO_PHASE,
        Hazard.SESSION_SILENT,
        Hazard.DEVICE_LOST,
        Hazard.ENERGY,
        Hazard.MISSED_DEADLINES,
    ):
        hazards[str(one.name).lower()] = one
