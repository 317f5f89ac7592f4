"""Forces at random and hostile positions, phases, laws and session inputs, with the rules for all of them.

A force is finite and within its cap; an input that is not a number gives none, and FAULT; from tick to tick a
force changes by no more than the device's slew, unless it fades, and then it does not grow.
"""

import math
import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from toy_ball import ball_model

from dvf_ig.core import (
    FloatArray,
    InvalidInputError,
    PhaseForecast,
    PhaseState,
    PoseMotion,
    RetimingCurve,
    Rigid,
)
from dvf_ig.guidance import (
    Confinement,
    Contribution,
    DeviceLimits,
    Evaluator,
    FeedForward,
    FixtureOptions,
    Fixtures,
    FixtureSet,
    Gaussian,
    Hazard,
    PoseAndPhase,
    Sigmoid,
    Status,
    SupervisorState,
    compose,
)
from dvf_ig.guidance.blend import Blend
from dvf_ig.guidance.devices.recorded import RecordedDevice
from dvf_ig.guidance.servo import ServoInputs, ServoOptions, SimulatedServo
from dvf_ig.guidance.supervision.supervisor import SLEW_SPEED_M_S
from dvf_ig.kernels.servo.layout import INPUTS

HOSTILE = np.array(
    [
        math.nan,
        math.inf,
        -math.inf,
        1e300,
        -1e300,
        1e154,
        5e-324,
        -5e-324,
        1e-300,
        -0.0,
        0.0,
        1e9,
        -30.0,
        29.0,
    ]
)
POINTS = 2000
TICKS = 250
"""Points of a batch, and ticks of a run, that share a law, a pose and a phase clock."""
STIFF = DeviceLimits(stiffness_n_per_m=4000.0)
ROUNDING = 1e-9

Finding = str
BLENDS: tuple[Blend, ...] = ("force", "distance", "periodic")
MODEL = ball_model()


def numbers(rng: np.random.Generator, shape: tuple[int, ...], spread: float, hostile: float) -> FloatArray:
    """Draw normal numbers, a share of which are hostile ones."""
    values = rng.normal(0.0, spread, shape)
    chosen = rng.random(shape) < hostile
    values[chosen] = rng.choice(HOSTILE, int(chosen.sum()))
    return values


def law(rng: np.random.Generator) -> Sigmoid | Confinement | Gaussian:
    cap_n, depth_mm = float(10 ** rng.uniform(-3, 0.5)), float(rng.normal(0.0, 4.0))
    if rng.random() < 0.4:
        return Gaussian(float(10 ** rng.uniform(-1, 2)), float(rng.uniform(0.5, 5.0)), cap_n, depth_mm)
    kind = Sigmoid if rng.random() < 0.6 else Confinement
    return kind(float(10 ** rng.uniform(-0.6, 1)), cap_n, depth_mm)


def pose(rng: np.random.Generator, source: str) -> Rigid:
    return Rigid.from_rotation_vector(rng.normal(size=3), rng.normal(0.0, 5.0, 3), MODEL.frame, source)


def transform(rng: np.random.Generator) -> PoseAndPhase:
    """Draw pose and phase as functions of time, each of which may be unknown from some time on."""
    start, end = pose(rng, "tracker"), pose(rng, "tracker")
    motion = PoseMotion.towards(start, end, float(rng.uniform(0.0, 0.2)), np.zeros(3))
    clock = PhaseForecast(
        since_s=0.0,
        until_s=float(rng.exponential(2.0)),
        state=PhaseState.LOCKED,
        state_after=PhaseState.LOST,
        phi=float(rng.random()),
        r_s=-0.08,
        cycles=0.0,
        rr_s=float(10 ** rng.uniform(-0.6, 0.6)),
        spread=0.05,
        catch_up=3.0,
        r_timing_s=0.005,
    )
    spread = None if rng.random() < 0.3 else float(10 ** rng.uniform(-3, 3)) * np.eye(6)
    until_s = math.inf if rng.random() < 0.7 else float(rng.exponential(1.0))
    return PoseAndPhase(
        None if rng.random() < 0.05 else motion, clock, RetimingCurve.uniform(), spread, pose_until_s=until_s
    )


def longest(forces_n: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(forces_n, axis=-1))


def wrong_with(
    forces_n: FloatArray, cap_n: float, finite: Any, status: Any, ok: Any, where: str
) -> Iterator[Finding]:
    """Report violations in (n, 3) forces, from `finite` inputs, their `status`, and `ok` input status."""
    if not np.isfinite(forces_n).all():
        yield f"{where}: a force that is not finite"
        return
    if (length := float(longest(forces_n).max(initial=0.0))) > cap_n * (1.0 + ROUNDING):
        yield f"{where}: a force {length / cap_n - 1.0:g} beyond its cap"
    faulty = ~finite & ok
    if forces_n[faulty].any():
        yield f"{where}: a force for an input that is not finite"
    if (status[faulty] != Status.FAULT).any():
        yield f"{where}: an input that is not finite has status {set(status[faulty].tolist())}"


def evaluate_batch(rng: np.random.Generator) -> Iterator[Finding]:
    """Evaluate points of a model, through a pose, at phases."""
    blend = BLENDS[rng.integers(3)]
    evaluator = Evaluator(MODEL, law(rng), blend=blend, device=STIFF)
    hostile = float(rng.choice([0.0, 0.01, 0.2]))
    xyz = numbers(rng, (POINTS, 3), 18.0, hostile)
    phase = numbers(rng, (POINTS,), 1.0, hostile)
    status = np.where(rng.random(POINTS) < 0.9, 0, rng.integers(0, 7, POINTS))
    forces = evaluator.force_through(pose(rng, "tracker"), xyz, phase, status)
    finite = np.isfinite(xyz).all(axis=1) & np.isfinite(phase)
    yield from wrong_with(
        forces.force_n, evaluator.law.cap_n, finite, forces.status, status == Status.OK, f"evaluator {blend}"
    )


def guide_batch(rng: np.random.Generator) -> Iterator[Finding]:
    """Evaluate tool tips of a tracker at times, through pose and phase."""
    evaluator = Evaluator(MODEL, law(rng), blend=BLENDS[rng.integers(3)], device=STIFF)
    hostile = float(rng.choice([0.0, 0.01, 0.2]))
    tip, t_s = numbers(rng, (POINTS, 3), 18.0, hostile), numbers(rng, (POINTS,), 3.0, hostile)
    status = np.where(rng.random(POINTS) < 0.9, 0, rng.integers(0, 6, POINTS))
    forces = transform(rng).evaluate(evaluator, tip, t_s, status)
    finite = np.isfinite(tip).all(axis=1) & np.isfinite(t_s)
    yield from wrong_with(
        forces.force_n, evaluator.law.cap_n, finite, forces.status, status == Status.OK, "pose and phase"
    )


def compose_batch(rng: np.random.Generator) -> Iterator[Finding]:
    """Compose forces of up to eight fixtures, and check the rejected part."""
    for _ in range(POINTS // 4):
        caps = 10 ** rng.uniform(-9, 1.3, int(rng.integers(1, 9)))
        parts = []
        for cap in caps.tolist():
            force = rng.normal(size=3) if rng.random() < 0.8 else np.eye(3)[rng.integers(3)]
            share = rng.choice([0.0, 5e-324, 1e-12, 0.5, 1.0 - 1e-16, 1.0, rng.random()])
            parts.append(Contribution("tracker", force / np.linalg.norm(force) * share * cap, cap))
        split, cap_n = int(rng.integers(0, len(parts) + 1)), float(10 ** rng.uniform(-9, 1.3))
        got = compose(parts[:split], parts[split:], frame="tracker", cap_n=cap_n)
        both = np.stack([got.force_n, got.forbidden_n, got.guidance_n, got.rejected_n])
        if not np.isfinite(both).all():
            yield "composition: a force that is not finite"
        elif longest(both[:3]).max() > cap_n * (1.0 + ROUNDING):
            yield f"composition: a force {longest(both[:3]).max() / cap_n - 1.0:g} beyond the cap"


class Corrupted:
    """Inputs that a session publishes, with some of their numbers damaged on the way.

    Codes and the device's pose stay intact: integers, and a `Rigid`, which is checked at construction.
    """

    def __init__(self, inputs: ServoInputs, rng: np.random.Generator, places: int) -> None:
        self.now_s, self.transform, self._inputs = inputs.now_s, inputs.transform, inputs
        offset, size = (
            {name: field[1] // 8 for name, field in (INPUTS.fields or {}).items()},
            INPUTS.itemsize // 8,
        )
        whole = {offset["hazards"], offset["tool_status"]}
        whole.update(range(offset["tracker_from_device"], offset["margin_mm"]))
        allowed = [at for at in range(size) if at not in whole]
        self._at, self._by = rng.choice(allowed, places), rng.choice(HOSTILE, places)

    def packed(self, clock_s: float) -> Any:
        values = self._inputs.packed(clock_s)
        values.view(np.float64)[self._at] = self._by
        return values


def servo_batch(rng: np.random.Generator) -> Iterator[Finding]:
    """Run the servo with changing session inputs, a jumping tool and damaged numbers."""
    parts = tuple(
        FixtureOptions(law(rng), BLENDS[rng.integers(3)], name=str(i)) for i in range(rng.integers(1, 5))
    )
    cap_n = None if rng.random() < 0.5 else float(10 ** rng.uniform(-2, 0.5))
    fixtures = Fixtures(MODEL, FixtureSet(parts, cap_n, device=STIFF))
    path = np.cumsum(rng.normal(0.0, 0.05, (8 * TICKS, 3)), axis=0) + rng.normal(0.0, 12.0, 3)
    path += np.where(rng.random((len(path), 1)) < 0.002, numbers(rng, path.shape, 20.0, 0.3), 0.0)
    device = RecordedDevice(path, 1000.0)
    forward = (
        FeedForward(float(rng.uniform(0, 2)), float(rng.uniform(0, 0.1)))
        if rng.random() < 0.5
        else FeedForward()
    )
    limits = DeviceLimits(stiffness_n_per_m=float(rng.uniform(300, 3000)))
    servo = SimulatedServo(fixtures, device, limits=limits, options=ServoOptions(feed_forward=forward))
    slew_n, before, at = limits.stiffness_n_per_m * SLEW_SPEED_M_S * 1e-3, np.zeros(3), 0
    joint = fixtures.options.joint_cap_n
    for _ in range(8):
        hazards = Hazard(int(rng.integers(0, 1 << 15))) if rng.random() < 0.1 else Hazard.NONE
        status = Status(int(rng.integers(0, 6))) if rng.random() < 0.1 else Status.OK
        device_pose = Rigid.from_rotation_vector(rng.normal(size=3), rng.normal(size=3), "tracker", "device")
        margin = np.abs(rng.normal(0.0, 2.0, len(parts)))
        said: Any = ServoInputs(
            transform(rng),
            servo.now_s,
            device_pose,
            hazards,
            status,
            margin,
            float(rng.choice([0.01, 0.3, 9.0])),
        )
        damaged = rng.random() < 0.3
        if damaged:
            said = Corrupted(said, rng, int(rng.integers(1, 4)))
        if rng.random() < 0.3:
            servo.ask_rearm()
        record = servo.run(said, TICKS)
        hit = ~np.isfinite(path[at : at + TICKS]).all(axis=1)
        at += TICKS
        yield from _wrong_with_record(record, joint, slew_n, before, hit, damaged)
        before = record.sent_n[-1]
    if not np.isfinite(device.force_n).all() or longest(device.force_n).max() > joint * (1.0 + ROUNDING):
        yield "servo: the device was sent a force beyond the cap, or one that is not finite"


def _wrong_with_record(
    record: Any, cap_n: float, slew_n: float, before: FloatArray, hit: Any, damaged: bool
) -> Iterator[Finding]:
    kind = "servo with damaged inputs" if damaged else "servo"
    sent = np.concatenate([before[None], record.sent_n])
    tracked = ~np.isin(record.status, [Status.STALE_TOOL])
    yield from wrong_with(record.sent_n, cap_n, np.ones(len(record), bool), record.status, tracked, kind)
    if not damaged:
        yield from wrong_with(record.wanted_n, cap_n, ~hit, record.status, tracked, f"{kind}, wanted")
    step, length = longest(np.diff(sent, axis=0)), longest(sent)
    fading = (record.state == SupervisorState.FADE) | (record.state == SupervisorState.LATCHED)
    if (step[~fading] > slew_n * (1.0 + 1e-6)).any():
        yield f"{kind}: a step of {step[~fading].max():g} N; the slew allows {slew_n:g} N"
    if (length[1:] > length[:-1] + ROUNDING)[fading].any():
        yield f"{kind}: a force that grows while it fades"


BATCHES: tuple[tuple[Callable[[np.random.Generator], Iterator[Finding]], int], ...] = (
    (evaluate_batch, POINTS),
    (guide_batch, POINTS),
    (compose_batch, POINTS // 4),
    (servo_batch, 8 * TICKS),
)


def fuzz_forces(cases: int, seed: int) -> int:
    """Run at least `cases` cases, print each kind of finding with its batch, and return their number."""
    counts: dict[str, int] = {}
    kinds: set[str] = set()
    number = 0
    while sum(counts.values()) < cases:
        batch, size = BATCHES[number % len(BATCHES)]
        rng = np.random.default_rng([seed, number])
        try:
            findings = list(batch(rng))
        except InvalidInputError as error:  # a law beyond the device, or a wall that reaches too far
            findings = [] if "stiff" in str(error) or "felt" in str(error) else [f"refused: {error}"]
            size = 0
        counts[batch.__name__] = counts.get(batch.__name__, 0) + size
        for what in findings:
            kind = re.sub(r"[-+.e0-9]{2,}", "#", what)
            if kind not in kinds:
                kinds.add(kind)
                print(f"batch {number} of seed {seed}: {what}", flush=True)
        number += 1
    print(f"{sum(counts.values())} forces: {counts}; {len(kinds)} kinds of findings")
    return len(kinds)
