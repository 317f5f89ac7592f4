"""Push a stylus against walls of three times the passive γ, a wall that beats, and a wall behind a line.

The motion that is left without and with the passivity controller, the work that a beating wall does on a hand
in a cycle, and what does not repeat from cycle to cycle at a guided line that beats before a wall that
does not. Simulated devices; nothing is random.

    dvf-ig study passivity
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import (
    CycleTiming,
    DvfModel,
    FloatArray,
    Mesh,
    PhaseForecast,
    PhaseState,
    PoseMotion,
    RetimingCurve,
    Rigid,
    read_only_arrays,
)
from dvf_ig.guidance import (
    DEVICES,
    DeviceLimits,
    FixtureOptions,
    Fixtures,
    FixtureSet,
    Gaussian,
    Law,
    PathTarget,
    PoseAndPhase,
    Sigmoid,
    SimulatedDevice,
    SupervisorState,
)
from dvf_ig.guidance.devices.simulated import PREMIUM, Hand, SimulatedStylus
from dvf_ig.guidance.laws import gaussian_steepness
from dvf_ig.guidance.servo import ServoInputs, ServoOptions, ServoRecord, SimulatedServo
from dvf_ig.study.driver import Driver, Result, Rows, Study
from dvf_ig.study.options import option


@dataclass(frozen=True, kw_only=True)
class PassivitySettings:
    """Options of the study."""

    seconds: float = option("Length of a push.", 20.0, least=2.0)


KNOT_MM = 5.0
CELLS = 16
HALF_MM = 0.5 * KNOT_MM * CELLS


def wall_model(amplitude_mm: float = 0.0, *, phases: int = 20, rr_s: float = 0.6) -> DvfModel:
    """The half-space x > 0 is the organ: d = x, or d = x − x_w(φ) with x_w = ½A(1 − cos 2πφ).

    Args:
        amplitude_mm: A, from end to end of the wall's motion.
        phases: of the cycle.
        rr_s: its length.
    """
    place = KNOT_MM * (np.arange(CELLS + 3) - 1.0) - HALF_MM
    wall = 0.5 * amplitude_mm * (1.0 - np.cos(2.0 * np.pi * np.arange(phases) / phases))
    shape = (phases, CELLS + 3, CELLS + 3, CELLS + 3)
    field = place[None, :, None, None] - wall[:, None, None, None]
    triangle = Mesh("mr", np.eye(3), np.array([[0, 1, 2]]))
    return DvfModel(
        patient_id="wall",
        surface_name="WALL",
        frame="mr",
        timing=CycleTiming.uniform(phases, rr_s),
        es_fraction=0.4,
        ed_phase=0,
        coefficients=np.broadcast_to(field, shape).astype(np.float32),
        origin_mm=np.full(3, -HALF_MM),
        knot_spacing_mm=KNOT_MM,
        reference=(triangle,) * phases,
        reference_caps=(np.zeros(1, dtype=np.bool_),) * phases,
    )


UNLIMITED = DeviceLimits(stiffness_n_per_m=1e5)
"""Fixtures beyond a device's limit are refused; the study asks what would happen with them."""


WATCHED_S = 1.0
"""The true tip is recorded over the last second."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Pressing:
    """One run.

    Attributes:
        record: of the servo, every tick.
        last_mm: (n, 3) true tip during the last second.
    """

    record: ServoRecord
    last_mm: FloatArray

    @property
    def rms_mm(self) -> float:
        """RMS of the true tip about its mean, along the wall's normal, over the last second."""
        return float(np.std(self.last_mm[:, 0]))

    def unrepeated_mm(self, ticks: int) -> float:
        """RMS change of the true tip from one cycle of `ticks` ticks to the next, in the last second."""
        change = self.last_mm[ticks:] - self.last_mm[:-ticks]
        return float(np.sqrt((change**2).sum(axis=1).mean()))


def press(
    model: DvfModel,
    fixtures: FixtureSet,
    device: SimulatedDevice,
    hand: Hand,
    *,
    seconds: float,
    start_mm: float,
    options: ServoOptions,
    delay_s: float = 0.0,
) -> Pressing:
    """Let a hand push a device's stylus into the wall.

    Args:
        fixtures: on the wall, or in front of it; their device's stiffness gives the slew limit.
        hand: on the stylus; +x leads into the wall.
        seconds: more than one.
        start_mm: where the tip starts, at rest, along the normal.
        delay_s: of the device.
    """
    stylus = SimulatedStylus(device, np.array([start_mm, 0.0, 0.0]), delay_s=delay_s, hand=hand)
    servo = SimulatedServo(Fixtures(model, fixtures), stylus, limits=fixtures.device, options=options)
    transform, device_at = steady_transform(model), Rigid.identity("tracker", "device")

    def run(ticks: int) -> ServoRecord:
        return servo.run(ServoInputs(transform, servo.now_s, device_at, valid_for_s=2.0 * seconds), ticks)

    watched = round(WATCHED_S * options.rate_hz)
    rows = [run(round(seconds * options.rate_hz) - watched).rows]
    last = np.empty((watched, 3))
    for k in range(watched):
        rows.append(run(1).rows)
        last[k] = stylus.position_mm
    return Pressing(ServoRecord(np.concatenate(rows)), last)


def on_the_wall(law: Law) -> FixtureSet:
    """One fixture, however stiff."""
    return FixtureSet((FixtureOptions(law),), device=UNLIMITED)


def steady_transform(
    model: DvfModel, *, pose: Rigid | None = None, rr_s: float | None = None, phase_offset: float = 0.0
) -> PoseAndPhase:
    """A pose that stays, and a heart that beats evenly.

    Args:
        pose: mr_from_tracker; None: identity.
        rr_s: length of a beat; None: of the model's own cycle.
        phase_offset: phase at time 0, in [0, 1).
    """
    length_s = model.timing.rr_s if rr_s is None else rr_s
    beat = PhaseForecast(
        since_s=-1.0,
        until_s=math.inf,
        state=PhaseState.LOCKED,
        state_after=PhaseState.LOST,
        phi=0.0,
        r_s=-phase_offset * length_s,
        cycles=0.0,
        rr_s=length_s,
        spread=0.05,
        catch_up=3.0,
        r_timing_s=0.005,
    )
    still = PoseMotion.still(Rigid.identity(model.frame, "tracker") if pose is None else pose)
    return PoseAndPhase(still, beat, RetimingCurve.uniform(), np.eye(6))


CAP_N = 0.6
PUSH_N = 0.3
STEEP = 3.0
"""Steepness of the wall, as a multiple of the largest γ that the device renders passively."""
UNBOUNDED_MJ = 1e9
"""The energy limit is off where a limit cycle is to be seen: at 5 mJ the force is withdrawn."""
FASTEST_MM_S = 150.0
VISCOUS = SimulatedDevice("viscous arm", 0.05, 0.1, 0.0, 0.0, 3.3)
VISCOUS_WITH_SENSOR = SimulatedDevice("viscous arm, 0.03 mm sensor", 0.05, 0.1, 0.0, 0.03, 3.3)
CYCLES = 30
AMPLITUDE_MM, RR_S = 5.0, 0.6
GAP_MM, MARGIN_MM, LINE_CAP_N = 4.0, 2.0, 0.4
"""Least distance of the line from the wall, where half of the wall's force is felt, the line's cap."""


@dataclass(frozen=True, slots=True)
class WallCase:
    """A hand's constant push against a wall three times too steep.

    Attributes:
        device: mass, frictions, resolution; delay_s: of it.
        gamma_per_mm, limit_per_mm: of the wall, and the largest that is passive.
        without_mm, with_mm: RMS of the true tip over the last second, without and with the controller.
        limit_reached_s: when the energy limit would have withdrawn the uncontrolled force; NaN never.
        largest_residual_mj: with the controller.
    """

    device: SimulatedDevice
    delay_s: float
    gamma_per_mm: float
    limit_per_mm: float
    without_mm: float
    with_mm: float
    limit_reached_s: float
    largest_residual_mj: float


@dataclass(frozen=True, slots=True)
class BeatingCase:
    """A hand that rests against a beating wall, mean over cycles.

    Attributes:
        hand: what holds the stylus.
        by_surface_mj: work of the moving surface on the hand, a cycle.
        given_mj: all work on the hand, a cycle.
        largest_by_surface_mj: in any cycle.
    """

    hand: str
    by_surface_mj: float
    given_mj: float
    largest_by_surface_mj: float


@dataclass(frozen=True, slots=True)
class LineCase:
    """A hand's constant push off a guided line into a wall behind it, each as stiff as the device allows.

    Attributes:
        device: what renders them.
        amplitude_mm: from end to end of the line's motion; 0: it does not beat.
        without_mm, with_mm: RMS change of the true tip from cycle to cycle, without and with the controller.
        largest_n: force sent, with the controller.
        largest_residual_mj: with the controller.
        state: of the supervisor at the end, with the controller.
    """

    device: str
    amplitude_mm: float
    without_mm: float
    with_mm: float
    largest_n: float
    largest_residual_mj: float
    state: str


def lines_before_walls() -> list[LineCase]:
    """Both simulated devices, the line at rest and beating."""
    return [
        _line_before_wall(device, amplitude_mm)
        for device in DEVICES.values()
        for amplitude_mm in (0.0, AMPLITUDE_MM)
    ]


def steep_walls(seconds: float = 20.0) -> list[WallCase]:
    """Devices with and without a sensor step, dry friction and a delay."""
    cases = ((VISCOUS, 0.0), (VISCOUS_WITH_SENSOR, 0.0), (VISCOUS, 0.001), (PREMIUM, 0.001))
    return [_steep_wall(device, delay_s, seconds) for device, delay_s in cases]


def beating_walls() -> list[BeatingCase]:
    """The limit's own γ on a PHANToM Premium, in hands of growing stiffness and one that pushes."""
    hands = {
        "spring 100 N/m": Hand(stiffness_n_per_m=100.0, damping_n_s_per_m=2.0),
        "spring 400 N/m": Hand(stiffness_n_per_m=400.0, damping_n_s_per_m=4.0),
        "push 0.3 N, damping 5 N·s/m": Hand(push_n=np.array([0.3, 0.0, 0.0]), damping_n_s_per_m=5.0),
    }
    return [_beating_wall(name, hand) for name, hand in hands.items()]


def passive_gamma(device: SimulatedDevice) -> float:
    """γ ≤ 4K/F with K the largest passive stiffness (`DeviceLimits`); dry friction counts up to 150 mm/s."""
    moving = FASTEST_MM_S if device.dry_n > 0.0 else np.inf
    limits = DeviceLimits(
        rate_hz=device.rate_hz,
        damping_n_s_per_m=device.viscous_n_s_per_m,
        friction_n=device.dry_n,
        resolution_mm=device.resolution_mm if device.dry_n > 0.0 else 0.0,
        fastest_mm_s=moving,
    )
    return 4.0 * limits.passive_stiffness_n_per_mm / CAP_N


def _steep_wall(device: SimulatedDevice, delay_s: float, seconds: float) -> WallCase:
    limit = passive_gamma(device)
    model, law = wall_model(), Sigmoid(STEEP * limit, CAP_N)
    hand = Hand(push_n=np.array([PUSH_N, 0.0, 0.0]))
    runs = [
        press(
            model,
            on_the_wall(law),
            device,
            hand,
            seconds=seconds,
            start_mm=-1.0,
            options=options,
            delay_s=delay_s,
        )
        for options in (
            ServoOptions(largest_damping_n_s_per_m=0.0, residual_limit_mj=UNBOUNDED_MJ, predict_tool=False),
            ServoOptions(predict_tool=False),
        )
    ]
    over = np.flatnonzero(runs[0].record.residual_mj > ServoOptions().residual_limit_mj)
    return WallCase(
        device,
        delay_s,
        STEEP * limit,
        limit,
        runs[0].rms_mm,
        runs[1].rms_mm,
        float(runs[0].record.t_s[over[0]]) if len(over) else float("nan"),
        float(runs[1].record.residual_mj.max()),
    )


def _line_before_wall(device: SimulatedDevice, amplitude_mm: float) -> LineCase:
    model, limits = wall_model(rr_s=RR_S), device.limits(fastest_mm_s=FASTEST_MM_S)
    stiffest = (1.0 - 1e-9) * limits.allowed_stiffness_n_per_mm
    away_mm = GAP_MM + 0.5 * amplitude_mm * (1.0 + np.cos(2.0 * np.pi * model.timing.fractions))
    points = np.zeros((len(away_mm), 2, 3))
    points[:, :, 0], points[:, 1, 2] = -away_mm[:, None], 0.5 * HALF_MM
    line = Gaussian(gaussian_steepness(1.0) * LINE_CAP_N / stiffest, 1.0, LINE_CAP_N)
    fixtures = FixtureSet(
        (
            FixtureOptions(line, path=PathTarget("mr", points, model.timing)),
            FixtureOptions(Sigmoid(4.0 * stiffest / CAP_N, CAP_N, -MARGIN_MM)),
        ),
        device=limits,
    )
    free, controlled = (
        press(
            model,
            fixtures,
            device,
            Hand(push_n=np.array([PUSH_N, 0.0, 0.0])),
            seconds=(CYCLES + 1) * RR_S,
            start_mm=-GAP_MM - amplitude_mm,
            options=options,
        )
        for options in (
            ServoOptions(largest_damping_n_s_per_m=0.0, residual_limit_mj=UNBOUNDED_MJ),
            ServoOptions(),
        )
    )
    ticks, record = round(RR_S * device.rate_hz), controlled.record
    return LineCase(
        device.name,
        amplitude_mm,
        free.unrepeated_mm(ticks),
        controlled.unrepeated_mm(ticks),
        float(np.linalg.norm(record.sent_n, axis=1).max()),
        float(record.residual_mj.max()),
        SupervisorState(record.state[-1]).name,
    )


def _beating_wall(name: str, hand: Hand) -> BeatingCase:
    model = wall_model(AMPLITUDE_MM, rr_s=RR_S)
    fixtures, seconds = on_the_wall(Sigmoid(passive_gamma(PREMIUM), CAP_N)), (CYCLES + 1) * RR_S
    run = press(model, fixtures, PREMIUM, hand, seconds=seconds, start_mm=0.0, options=ServoOptions())
    ticks = round(RR_S * PREMIUM.rate_hz)
    by_surface, by_all = (
        np.diff(total[ticks - 1 :: ticks]) for total in (run.record.by_surface_mj, run.record.given_mj)
    )
    return BeatingCase(name, float(by_surface.mean()), float(by_all.mean()), float(by_surface.max()))


def run(settings: PassivitySettings, driver: Driver) -> Result:
    """Press against every wall."""
    walls, beating, lines = steep_walls(settings.seconds), beating_walls(), lines_before_walls()
    fields = {"steep_walls": walls, "beating_walls": beating, "lines_before_walls": lines}
    rows = [*_wall_rows(walls), *_beating_rows(beating), *_line_rows(lines)]
    return Result(fields, rows, {"passivity.json": fields})


def _wall_rows(walls: Sequence[WallCase]) -> Rows:
    rows: Rows = [
        ("device", "γ of limit, 1/mm", "RMS mm without", "with", "5 mJ after s", "residual mJ with")
    ]
    for wall in walls:
        d = wall.device
        device = (
            f"{d.name}: {1000 * d.mass_kg:g} g, b {d.viscous_n_s_per_m:g} N·s/m, dry {d.dry_n:g} N, step "
            f"{d.resolution_mm:g} mm, delay {1000 * wall.delay_s:g} ms, {d.rate_hz:g} Hz"
        )
        gamma = f"{wall.gamma_per_mm:.2f} of {wall.limit_per_mm:.2f}"
        numbers = (wall.without_mm, wall.with_mm, wall.limit_reached_s, wall.largest_residual_mj)
        rows.append((device, gamma, *(f"{value:.4f}" for value in numbers)))
    return rows


def _beating_rows(beating: Sequence[BeatingCase]) -> Rows:
    rows: Rows = [("hand at a beating wall", "by surface mJ a cycle", "most", "in all", "", "")]
    for case in beating:
        numbers = (case.by_surface_mj, case.largest_by_surface_mj, case.given_mj)
        rows.append((case.hand, *(f"{value:.3f}" for value in numbers), "", ""))
    return rows


def _line_rows(lines: Sequence[LineCase]) -> Rows:
    rows: Rows = [
        (
            "line before a wall",
            "line beats by mm",
            "change a cycle, mm RMS",
            "controlled",
            "N",
            "residual mJ",
        )
    ]
    for case in lines:
        numbers = (case.without_mm, case.with_mm, case.largest_n, case.largest_residual_mj)
        rows.append((case.device, f"{case.amplitude_mm:g}", *(f"{value:.4f}" for value in numbers)))
    return rows


STUDY = Study(PassivitySettings, run, outputs=lambda _: ("passivity.json",), trials=False, needs_folder=False)
