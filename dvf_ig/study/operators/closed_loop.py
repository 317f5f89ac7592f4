"""One operator at one task in closed loop: hand, device, servo, fixture, in simulated time at 1 kHz.

Here are also the conditions of the tasks (whether the force is felt, and what is wrong with it), the heart
that the operators work on, true and as the fixture knows it, and lines that ride on its beating surface.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple, Protocol

import numpy as np
from scipy.interpolate import CubicSpline

from data_synth.heart.motion import MotionPreset
from data_synth.operator.contact import MovingSurface
from data_synth.operator.contact_sites import Site
from data_synth.operator.fulcrum import Fulcrum
from data_synth.operator.held_instrument import HeldInstrument, Stylus
from data_synth.operator.operator_spec import OperatorSpec, drawn_operator
from data_synth.operator.simulated_operator import RATE_HZ, LearntForce, SimulatedOperator
from data_synth.seeds import child_rng
from dvf_ig.core import DvfModel, FloatArray, Rigid, read_only_arrays
from dvf_ig.guidance import (
    DEVICES,
    DeviceLimits,
    FixtureOptions,
    Fixtures,
    FixtureSet,
    Law,
    PoseAndPhase,
    SimulatedDevice,
)
from dvf_ig.guidance.servo import ServoInputs, ServoOptions, SimulatedServo
from dvf_ig.guidance.servo.inputs import VALID_FOR_S
from dvf_ig.guidance.supervision.supervisor import SupervisorState
from dvf_ig.study.passivity import steady_transform
from dvf_ig.study.tracking.stylus import FASTEST_MM_S, BeatingSurface, beating_surface

NO_HAPTICS = "visual only"
HAPTICS = "visual + haptic"
UNATTENDED = "haptic, not attended to"
"""The force moves the hand, and the operator makes nothing of it: what the fixture does by itself."""


@dataclass(frozen=True, slots=True)
class Condition:
    """One way to do a task.

    Attributes:
        name: in tables.
        haptic: the device's motors are on.
        beating: the heart beats; else it stands still at end-diastole.
        noise: factor on the operator's errors of depth.
        attends: the operator takes felt force for what it says of depth.
        foresight: factor on the share of the beat that the operator foresees.
        force_noise: factor on the errors of felt force, and on the least force that is felt.
        registration_mm: error of the registration, a shift in a direction drawn by the operator's seed.
        phase_error: of the fixture's phase, in cycles.
        lag_s: from a force to its effect; lag_known: the servo knows it.
        wrong_organ: the fixture is another person's heart, centred on this one's.
    """

    name: str
    haptic: bool = True
    beating: bool = True
    noise: float = 1.0
    attends: bool = True
    foresight: float = 1.0
    force_noise: float = 1.0
    registration_mm: float = 0.0
    phase_error: float = 0.0
    lag_s: float = 0.0
    lag_known: bool = False
    wrong_organ: bool = False


STILL, BEATING = "still heart", "beating heart"
MONO, STEREO = "mono", "stereo"
MONO_NOISE = 2.8
"""Factor on the error of depth with one eye, with which 40 operators (seeds 901 to 940) push pellets into a
still heart without a force as variably as people do in Table I of Ren 2008, SD 1.51 mm."""


def _three(prefix: str, common: Condition) -> tuple[Condition, ...]:
    """Without force, with it, and with it while the operator makes nothing of it."""
    return (
        replace(common, name=f"{prefix}{NO_HAPTICS}", haptic=False),
        replace(common, name=f"{prefix}{HAPTICS}"),
        replace(common, name=f"{prefix}{UNATTENDED}", attends=False),
    )


TASKS = {
    "cutting": (
        *_three(f"{STILL}, ", Condition("", beating=False, noise=MONO_NOISE)),
        *_three(f"{BEATING}, ", Condition("", noise=MONO_NOISE)),
    ),
    "dissection": (
        *_three(f"{MONO}, ", Condition("", beating=False, noise=MONO_NOISE)),
        *_three(f"{STEREO}, ", Condition("", beating=False)),
    ),
    "tracking": _three("manual, ", Condition("")),
    "lesion": _three(f"{BEATING}, ", Condition("", noise=MONO_NOISE)),
}
"""Conditions of each task."""

_REFERENCE = Condition(HAPTICS, noise=MONO_NOISE)
ABLATIONS = (
    *_three("", _REFERENCE),
    Condition(f"{STEREO}, visual only", haptic=False),
    replace(_REFERENCE, name=STEREO, noise=1.0),
    replace(_REFERENCE, name="force felt 3 times as badly", force_noise=3.0),
    Condition("beat not foreseen, visual only", haptic=False, noise=MONO_NOISE, foresight=0.0),
    replace(_REFERENCE, name="beat not foreseen", foresight=0.0),
    *(replace(_REFERENCE, name=f"registration error {mm} mm", registration_mm=float(mm)) for mm in (1, 2, 3)),
    *(
        replace(_REFERENCE, name=f"phase error {percent} %", phase_error=percent / 100)
        for percent in (5, 10, 50)
    ),
    *(replace(_REFERENCE, name=f"unknown lag {ms} ms", lag_s=ms / 1000) for ms in (5, 10, 20)),
    replace(_REFERENCE, name="known lag 20 ms", lag_s=0.02, lag_known=True),
    replace(_REFERENCE, name="wrong organ", wrong_organ=True),
)
"""Ablations of cutting on the beating heart; the first three are its conditions."""


HEART_SEED, OTHER_HEART_SEED = 1001, 1002
"""Hearts of the list TUNING (`dvf_ig.study.hearts.recordings`)."""
MOTION: MotionPreset = "paper5mm"
CYCLE_S = 0.6
"""20 volumes T_d = 0.03 s apart, as in the paper."""
STILL_S = 1e9
"""A heart that stands still has a cycle of this length."""
ACCESS = np.array([0.6, -0.7, 0.2]) / np.linalg.norm([0.6, -0.7, 0.2])
"""From the heart towards the operator."""


@dataclass(frozen=True, slots=True)
class OperatingHeart:
    """True surface and its model.

    Attributes:
        truth: true surface over the cycle.
        model: fitted to 20 phases of it; the registration's error is separate.
        cycle_s: length of a beat.
    """

    truth: MovingSurface
    model: DvfModel
    cycle_s: float = CYCLE_S

    def cycle(self, condition: Condition) -> float:
        """Length of a cycle, s."""
        return self.cycle_s if condition.beating else STILL_S

    def phase(self, condition: Condition, t_s: float) -> float:
        """True phase."""
        return (t_s / self.cycle(condition)) % 1.0

    def fixture_model(self, condition: Condition) -> DvfModel:
        """This heart's, or another person's."""
        return surface_of(OTHER_HEART_SEED).model if condition.wrong_organ else self.model

    def transform(self, condition: Condition, seed: int, begin_s: float = 0.0) -> PoseAndPhase:
        """Pose and phase that a session would publish, with the condition's errors.

        Args:
            seed: of the operator; draws the direction of the registration's error.
            begin_s: time by the servo's clock at which the heart is at phase 0.
        """
        model = self.fixture_model(condition)
        direction = child_rng(seed, "registration").standard_normal(3)
        shift = condition.registration_mm * direction / np.linalg.norm(direction)
        shift += model_center_mm(model) - model_center_mm(self.model)
        pose = Rigid(model.frame, "tracker", np.eye(3), shift)
        offset = condition.phase_error - begin_s / self.cycle(condition)
        return steady_transform(model, pose=pose, rr_s=self.cycle(condition), phase_offset=offset)


def operating_heart() -> OperatingHeart:
    """The heart of every trial."""
    surface = surface_of(HEART_SEED)
    return OperatingHeart(surface.truth, surface.model)


@cache
def surface_of(seed: int) -> BeatingSurface:
    """A phantom's true surface and its model, kept in the process; the worst of its places is the last."""
    return beating_surface(MOTION, cycle_s=CYCLE_S, seed=seed)


def model_center_mm(model: DvfModel) -> FloatArray:
    """(3,) mean of the reference surface's vertices at the first phase."""
    return np.asarray(model.reference[0].vertices_mm.mean(axis=0))


PHASES = 128
STEP_MM = 1.0
NEWTON_STEPS = 8
NEAREST = 4
"""Vertices whose motion a point of the surface follows."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class MovingLine:
    """Places along a line at every phase of the cycle, and their motion.

    Attributes:
        places_mm: (p, n, 3) at evenly spread phases from 0 on, STEP_MM apart along the line.
        rates_mm: (p, n, 3) their derivative by phase, mm a cycle.
    """

    places_mm: FloatArray
    rates_mm: FloatArray

    @property
    def length_mm(self) -> float:
        return STEP_MM * float(self.places_mm.shape[1] - 1)

    def at(self, along_mm: float, phase: float) -> FloatArray:
        """(3,) place."""
        return _between(self.places_mm, along_mm, phase)

    def rate_mm(self, along_mm: float, phase: float) -> FloatArray:
        """(3,) motion of a place with the beat, mm a cycle."""
        return _between(self.rates_mm, along_mm, phase)

    def points(self, phase: float) -> FloatArray:
        """(n, 3) all places."""
        return np.array([self.at(STEP_MM * k, phase) for k in range(self.places_mm.shape[1])])

    def tangent(self, along_mm: float) -> FloatArray:
        """(3,) mm along the line a mm, at phase 0."""
        here = min(max(along_mm, 0.0), self.length_mm - STEP_MM)
        return np.asarray((self.at(here + STEP_MM, 0.0) - self.at(here, 0.0)) / STEP_MM)


def moving_line(surface: MovingSurface, site: Site, length_mm: float, depth_mm: float) -> MovingLine:
    """A straight line over a site, projected onto the surface at phase 0, riding on it from then on.

    Args:
        surface: true.
        length_mm: 0 for a point.
        depth_mm: signed distance of its places to the surface, positive inside.
    """
    count = 1 + round(length_mm / STEP_MM)
    along = (np.arange(count) - 0.5 * (count - 1)) * STEP_MM
    return moving_points(surface, site.point_mm + along[:, None] * site.slide, depth_mm)


def moving_points(surface: MovingSurface, points_mm: FloatArray, depth_mm: float) -> MovingLine:
    """Points (n, 3), projected onto the surface at phase 0, riding on it at a depth from then on."""
    count = len(points_mm)
    base = _at_depth(surface, points_mm, 0.0, 0.0)
    resting = surface.at(0.0)
    apart = np.linalg.norm(base[:, None] - resting[None], axis=2)
    nearest = np.argsort(apart, axis=1)[:, :NEAREST]
    weight = 1.0 / (np.take_along_axis(apart, nearest, axis=1) + 1e-3)
    weight /= weight.sum(axis=1, keepdims=True)
    phases = np.arange(PHASES) / PHASES
    places = np.empty((PHASES, count, 3))
    for i, phase in enumerate(phases.tolist()):
        moved = (surface.at(phase) - resting)[nearest]
        places[i] = _at_depth(surface, base + np.einsum("ij,ijk->ik", weight, moved), phase, depth_mm)
    closed = np.concatenate([places, places[:1]])
    rates = CubicSpline(np.append(phases, 1.0), closed, bc_type="periodic")(phases, 1)
    return MovingLine(places, rates)


def _at_depth(surface: MovingSurface, xyz_mm: FloatArray, phase: float, depth_mm: float) -> FloatArray:
    """(n, 3) the points moved along the gradient until they are so deep."""
    out = np.array(xyz_mm)
    at = np.full(len(out), phase)
    for _ in range(NEWTON_STEPS):
        distance, gradient = surface.distance(out, at)
        out += (depth_mm - distance)[:, None] * gradient
    return out


def _between(table: FloatArray, along_mm: float, phase: float) -> FloatArray:
    p, n = table.shape[:2]
    u, v = (phase % 1.0) * p, min(max(along_mm / STEP_MM, 0.0), n - 1.0)
    i, k = int(u) % p, min(int(v), max(n - 2, 0))
    a, b, j, m = u - int(u), v - k, (i + 1) % p, min(k + 1, n - 1)
    low = (1.0 - b) * table[i, k] + b * table[i, m]
    high = (1.0 - b) * table[j, k] + b * table[j, m]
    return np.asarray((1.0 - a) * low + a * high)


DEVICE = DEVICES["premium"]
LIMITS = DEVICE.limits(fastest_mm_s=FASTEST_MM_S)
READINGS = 200
"""Forces at which an operator knows what they say."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """Constants of a trial.

    Attributes:
        heart, condition: see there.
        seed: of the operator.
        law: of the fixture on the heart's surface.
        start_mm: (3,) of the tip.
        sight: (3,) unit line of sight.
        target_depth_mm: where the task wants the tip, positive inside.
        fulcrum: of the instrument, if any.
        fixtures: in place of the law on the heart's surface.
        device: simulated, that the operator holds; limits: of it.
    """

    heart: OperatingHeart
    condition: Condition
    seed: int
    law: Law
    start_mm: FloatArray
    sight: FloatArray
    target_depth_mm: float
    fulcrum: Fulcrum | None = None
    fixtures: tuple[FixtureOptions, ...] = ()
    device: SimulatedDevice = DEVICE
    limits: DeviceLimits = LIMITS


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Course of a trial, at every step of the operator.

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


Task = Callable[[float, FloatArray, float], Aim]
"""Aim at a time (s), from the true tip (3,) and the error (mm) that the operator believes in; called once a
step, in order."""


class Player(Protocol):
    """Who holds the instrument, with the servo that drives it.

    Attributes:
        now_s: since the trial began; tip_mm: (3,) true tip; felt_n: (3,) force on the hand.
        believed_error_mm: distance between aim and tip by all that the player sees and feels.
    """

    @property
    def now_s(self) -> float: ...

    @property
    def tip_mm(self) -> FloatArray: ...

    @property
    def felt_n(self) -> FloatArray: ...

    @property
    def believed_error_mm(self) -> float: ...

    def step(self, aim: Aim) -> float:
        """Act until the next step; return the seconds in which the supervisor withheld the force."""


class SimulatedPlayer:
    """A simulated operator in simulated time."""

    def __init__(self, loop: Loop, longest_s: float) -> None:
        stylus = stylus_of(loop.device, loop.condition)
        stated_s = loop.condition.lag_s if loop.condition.lag_known else 0.0
        self._instrument = HeldInstrument(
            loop.start_mm, operator_of(loop).hand, stylus, fulcrum=loop.fulcrum, stated_latency_s=stated_s
        )
        self._operator = operator_with(loop, self._instrument)
        self._servo = SimulatedServo(
            fixtures_of(loop), self._instrument, limits=loop.limits, options=ServoOptions()
        )
        self._inputs = inputs_of(loop, 0.0, valid_for_s=2.0 * longest_s)
        self._step = 0

    @property
    def now_s(self) -> float:
        return self._step / RATE_HZ

    @property
    def tip_mm(self) -> FloatArray:
        return self._instrument.tip_mm

    @property
    def felt_n(self) -> FloatArray:
        return self._instrument.felt_n

    @property
    def believed_error_mm(self) -> float:
        return self._operator.believed_error_mm

    def step(self, aim: Aim) -> float:
        """See, feel, decide, and let the servo tick."""
        follow(self._operator, aim)
        state = self._servo.run(self._inputs, round(DEVICE.rate_hz / RATE_HZ)).state
        self._step += 1
        return int((state >= SupervisorState.FADE).sum()) / DEVICE.rate_hz


def run_task(
    loop: Loop,
    task: Task,
    longest_s: float,
    player: Player | None = None,
    watch: Callable[[float, Aim], None] | None = None,
) -> Trace:
    """Let a player do the task until it is over, or until time is up.

    Args:
        player: None: the simulated operator of the loop's seed.
        watch: called with each time and aim.
    """
    player = player or SimulatedPlayer(loop, longest_s)
    t_s, tips, forces, stages, withheld_s = [], [], [], [], 0.0
    while (now_s := player.now_s) < longest_s:
        tip = player.tip_mm
        aim = task(now_s, tip, player.believed_error_mm)
        if watch is not None:
            watch(now_s, aim)
        if aim.stage < 0.0:
            break
        t_s.append(now_s)
        tips.append(tip)
        forces.append(float(np.linalg.norm(player.felt_n)))
        stages.append(aim.stage)
        withheld_s += player.step(aim)
    tip_mm = np.array(tips)
    phases = np.array([loop.heart.phase(loop.condition, t) for t in t_s])
    depth = loop.heart.truth.distance(tip_mm, phases)[0]
    return Trace(np.array(t_s), tip_mm, np.array(forces), depth, np.array(stages), withheld_s)


def follow(operator: SimulatedOperator, aim: Aim) -> None:
    """Let an operator take the next step towards an aim."""
    operator.step(aim.place_mm, aim.planned_mm_s + operator.spec.anticipated_share * aim.beat_mm_s)


def stylus_of(device: SimulatedDevice, condition: Condition) -> Stylus:
    """Stylus of a simulated device, whose motors may be off."""
    return Stylus(
        device.mass_kg,
        device.viscous_n_s_per_m,
        device.dry_n,
        device.resolution_mm,
        device.largest_n if condition.haptic else 0.0,
        condition.lag_s,
    )


def operator_with(loop: Loop, instrument: HeldInstrument) -> SimulatedOperator:
    """The operator with the instrument in hand."""
    learnt = learnt_force(loop.law, loop.target_depth_mm) if loop.condition.haptic else None
    return SimulatedOperator(operator_of(loop), loop.seed, instrument, loop.sight, learnt)


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
    """Depth that an operator reads from the force of a law on the organ's surface.

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


def fixtures_of(loop: Loop) -> Fixtures:
    """Fixtures that act on the instrument."""
    options = loop.fixtures or (FixtureOptions(loop.law, "force"),)
    return Fixtures(loop.heart.fixture_model(loop.condition), FixtureSet(options, device=loop.limits))


def inputs_of(
    loop: Loop,
    now_s: float,
    *,
    begin_s: float = 0.0,
    place: Rigid | None = None,
    valid_for_s: float = VALID_FOR_S,
) -> ServoInputs:
    """Inputs that a session would publish at `now_s`, if the trial began at `begin_s` of the same clock.

    Args:
        place: tracker_from_device; None: the device moves in the tracker's axes.
    """
    transform = loop.heart.transform(loop.condition, loop.seed, begin_s)
    place = place or Rigid.identity("tracker", "device")
    return ServoInputs(transform, now_s, place, valid_for_s=valid_for_s)
