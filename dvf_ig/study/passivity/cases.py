"""The cases of `dvf-ig study passivity`: a wall three times too steep, and a wall that beats."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.guidance import DeviceLimits, Sigmoid, SimulatedDevice
from dvf_ig.guidance.devices.simulated import PREMIUM, Hand
from dvf_ig.guidance.servo import ServoOptions

from .pressing import press
from .wall import wall_model

CAP_N = 0.6
PUSH_N = 0.3
STEEP = 3.0
"""Of the largest γ that the device renders passively."""
UNBOUNDED_MJ = 1e9
"""The energy limit is off where a limit cycle is to be seen: at 5 mJ the force is withdrawn."""
FASTEST_MM_S = 150.0
VISCOUS = SimulatedDevice("viscous arm", 0.05, 0.1, 0.0, 0.0, 3.3)
VISCOUS_WITH_SENSOR = SimulatedDevice("viscous arm, 0.03 mm sensor", 0.05, 0.1, 0.0, 0.03, 3.3)
CYCLES = 30
AMPLITUDE_MM, RR_S = 5.0, 0.6


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
        press(model, law, device, hand, seconds=seconds, start_mm=-1.0, options=options, delay_s=delay_s)
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


def _beating_wall(name: str, hand: Hand) -> BeatingCase:
    model = wall_model(AMPLITUDE_MM, rr_s=RR_S)
    law = Sigmoid(passive_gamma(PREMIUM), CAP_N)
    run = press(model, law, PREMIUM, hand, seconds=(CYCLES + 1) * RR_S, start_mm=0.0, options=ServoOptions())
    ticks = round(RR_S * PREMIUM.rate_hz)
    by_surface, given = (
        np.diff(total[ticks - 1 :: ticks]) for total in (run.record.by_surface_mj, run.record.given_mj)
    )
    return BeatingCase(name, float(by_surface.mean()), float(given.mean()), float(by_surface.max()))
