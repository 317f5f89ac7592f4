"""A constant push against the wall, in simulated time: motion, energy, what the controller did."""

import math
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import (
    DvfModel,
    FloatArray,
    PhaseForecast,
    PhaseState,
    PoseMotion,
    RetimingCurve,
    Rigid,
    read_only_arrays,
)
from dvf_ig.guidance import (
    DeviceLimits,
    FixtureOptions,
    Fixtures,
    FixtureSet,
    Law,
    PoseAndPhase,
    SimulatedDevice,
)
from dvf_ig.guidance.devices.simulated import Hand, SimulatedStylus
from dvf_ig.guidance.servo import ServoInputs, ServoOptions, ServoRecord, SimulatedServo

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


def press(
    model: DvfModel,
    law: Law,
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
        hand: on the stylus; +x leads into the wall.
        seconds: more than one.
        start_mm: where the tip starts, at rest, along the normal.
        delay_s: of the device.
    """
    stylus = SimulatedStylus(device, np.array([start_mm, 0.0, 0.0]), delay_s=delay_s, hand=hand)
    fixtures = Fixtures(model, FixtureSet((FixtureOptions(law),), device=UNLIMITED))
    servo = SimulatedServo(fixtures, stylus, limits=UNLIMITED, options=options)
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
