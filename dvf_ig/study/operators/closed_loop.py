"""One operator at one task in closed loop: hand, device, servo, fixture, in simulated time at 1 kHz."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from data_synth.operator.felt_force import LearntForce
from data_synth.operator.fulcrum import Fulcrum
from data_synth.operator.held_instrument import HeldInstrument, Stylus
from data_synth.operator.operator_spec import OperatorSpec, drawn_operator
from data_synth.operator.simulated_operator import RATE_HZ, SimulatedOperator
from dvf_ig.core import FloatArray, Rigid, read_only_arrays
from dvf_ig.guidance import DEVICES, FixtureOptions, Fixtures, FixtureSet, Law
from dvf_ig.guidance.devices.protocol import HapticDevice
from dvf_ig.guidance.servo import ServoInputs, ServoOptions, SimulatedServo
from dvf_ig.guidance.supervision.supervisor import SupervisorState
from dvf_ig.study.stylus.holding import FASTEST_MM_S

from .conditions import Condition
from .heart import OperatingHeart

DEVICE = DEVICES["premium"]
LIMITS = DEVICE.limits(fastest_mm_s=FASTEST_MM_S)
READINGS = 200
"""Forces at which an operator knows what they say."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """What stays the same through a trial.

    Attributes:
        heart, condition: see there.
        seed: of the operator.
        law: of the fixture on the heart's surface.
        start_mm: (3,) of the tip.
        sight: (3,) unit line of sight.
        target_depth_mm: where the task wants the tip, positive inside.
        fulcrum: of the instrument, if any.
    """

    heart: OperatingHeart
    condition: Condition
    seed: int
    law: Law
    start_mm: FloatArray
    sight: FloatArray
    target_depth_mm: float
    fulcrum: Fulcrum | None = None


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """What happened, at every step of the operator.

    Attributes:
        t_s: (n,).
        tip_mm: (n, 3) true tip.
        force_n: (n,) size of the device's force on the hand.
        depth_mm: (n,) signed distance of the tip to the true surface, positive inside.
        stage: (n,) number that the task gave.
        withheld_s: time for which the supervisor withheld a force.
    """

    t_s: FloatArray
    tip_mm: FloatArray
    force_n: FloatArray
    depth_mm: FloatArray
    stage: FloatArray
    withheld_s: float


class Aim(NamedTuple):
    """Where the tip should be now.

    Attributes:
        place_mm: (3,) now.
        planned_mm_s: (3,) velocity by the operator's own plan.
        beat_mm_s: (3,) velocity with the heart, at the moment at which the operator believes to be.
        stage: for the record; negative: the task is over.
    """

    place_mm: FloatArray
    planned_mm_s: FloatArray
    beat_mm_s: FloatArray
    stage: float = 0.0


Task = Callable[[float, FloatArray, SimulatedOperator], Aim]
"""Aim at a time (s), from the true tip (3,) and the operator's state; called once a step, in order."""


def run_task(loop: Loop, task: Task, longest_s: float) -> Trace:
    """Let the operator do the task until it is over, or until time is up."""
    condition = loop.condition
    spec = operator_of(loop)
    stylus = Stylus(
        DEVICE.mass_kg,
        DEVICE.viscous_n_s_per_m,
        DEVICE.dry_n,
        DEVICE.resolution_mm,
        DEVICE.largest_n if condition.haptic else 0.0,
        condition.lag_s,
    )
    instrument = HeldInstrument(
        loop.start_mm,
        spec.hand,
        stylus,
        fulcrum=loop.fulcrum,
        stated_latency_s=condition.lag_s if condition.lag_known else 0.0,
    )
    learnt = learnt_force(loop.law, loop.target_depth_mm) if condition.haptic else None
    operator = SimulatedOperator(spec, loop.seed, instrument, loop.sight, learnt)
    servo, inputs = _servo(loop, instrument, longest_s)
    ticks = round(DEVICE.rate_hz / RATE_HZ)
    tips, forces, stages, withheld = [], [], [], 0
    for k in range(round(longest_s * RATE_HZ)):
        tip = instrument.tip_mm
        aim = task(k / RATE_HZ, tip, operator)
        if aim.stage < 0.0:
            break
        tips.append(tip)
        forces.append(float(np.linalg.norm(instrument.felt_n)))
        stages.append(aim.stage)
        operator.step(aim.place_mm, aim.planned_mm_s + spec.anticipated_share * aim.beat_mm_s)
        state = servo.run(inputs, ticks).state
        withheld += int((state >= SupervisorState.FADE).sum())
    t_s, tip_mm = np.arange(len(tips)) / RATE_HZ, np.array(tips)
    phases = np.array([loop.heart.phase(condition, t) for t in t_s.tolist()])
    depth = loop.heart.truth.distance(tip_mm, phases)[0]
    return Trace(t_s, tip_mm, np.array(forces), depth, np.array(stages), withheld / DEVICE.rate_hz)


def operator_of(loop: Loop) -> OperatorSpec:
    """The operator under the trial's condition."""
    condition, drawn = loop.condition, drawn_operator(loop.seed, OperatorSpec())
    return replace(
        drawn,
        depth_noise_mm=drawn.depth_noise_mm * condition.noise,
        attends=condition.attends,
        anticipated_share=drawn.anticipated_share * condition.foresight,
        force_noise_n=drawn.force_noise_n * condition.force_noise,
        weber=drawn.weber * condition.force_noise,
    )


def learnt_force(law: Law, target_depth_mm: float) -> LearntForce:
    """What the force of a law on the organ's surface says to one who knows it.

    A forbidden region's force says how deep the tip is; a guidance's how far away its target is.
    """
    share = np.linspace(0.01, 0.97, READINGS)
    distance = np.linspace(-15.0, 15.0, 60001)
    potential = np.abs(law.potential(distance + law.depth_mm))
    if law.potential(np.array([-1.0 + law.depth_mm]))[0] < 0.0:  # pulls from both sides
        distance, potential = distance[distance >= 0.0], potential[distance >= 0.0]
        return LearntForce(law.cap_n * share, np.interp(share, potential, distance))
    inside_mm = np.interp(share, potential, distance)
    return LearntForce(law.cap_n * share, inside_mm + law.depth_mm - target_depth_mm)


def _servo(loop: Loop, instrument: HapticDevice, longest_s: float) -> tuple[SimulatedServo, ServoInputs]:
    model = loop.heart.fixture_model(loop.condition)
    fixtures = Fixtures(model, FixtureSet((FixtureOptions(loop.law, "force"),), device=LIMITS))
    servo = SimulatedServo(fixtures, instrument, limits=LIMITS, options=ServoOptions())
    inputs = ServoInputs(
        loop.heart.transform(loop.condition, loop.seed),
        0.0,
        Rigid.identity("tracker", "device"),
        valid_for_s=2.0 * longest_s,
    )
    return servo, inputs
