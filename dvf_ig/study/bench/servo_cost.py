"""What a tick of the servo and one dynamic force cost in a kernel, beside the C++ floor, in one run."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from dvf_ig.core import DvfModel, FloatArray, Rigid
from dvf_ig.guidance import Evaluator, Fixtures, PoseAndPhase, Sigmoid
from dvf_ig.guidance.device import COMMON_DEVICE
from dvf_ig.guidance.servo import ServoInputs, ServoOptions
from dvf_ig.guidance.servo.bound import bind_fixtures
from dvf_ig.kernels.compiled import kernel
from dvf_ig.kernels.servo.borrowed import borrowed
from dvf_ig.kernels.servo.layout import new_scratch
from dvf_ig.kernels.servo.tick import servo_tick

from .cpp_floor import compiled_floor
from .heart import CYCLE_S, RATE_HZ, hand_path, random_points
from .rows import POSE, batch_of, steady
from .servo import TWO_FIXTURES
from .timing import Row, row

POINTS = 10_000
CALLS = 1000
"""Points between two readings of the clock."""
PASSES = 15

Pass = Callable[[int, int], object]


@dataclass(frozen=True, slots=True)
class TickCost:
    """Rows, and ratios of their medians to the floor's; no ratio without a C++ compiler."""

    rows: tuple[Row, ...]
    ratios: dict[str, float]


def bench_tick(model: DvfModel, seed: int) -> TickCost:
    """One force and one tick on a hand's path, and one force at random places and phases."""
    rng = np.random.default_rng(seed)
    mesh = model.reference[model.ed_phase]
    back = POSE.inverse()
    path = np.ascontiguousarray(back.apply_array(hand_path(mesh, POINTS, rng)))
    anywhere = np.ascontiguousarray(back.apply_array(random_points(mesh, POINTS, rng)))
    phase = (np.arange(POINTS) / (RATE_HZ * CYCLE_S)) % 1.0
    anywhen = rng.uniform(size=POINTS)
    law = Sigmoid()
    arguments = Evaluator(model, law).kernel_arguments(POSE)
    passes: dict[str, Pass] = {
        "one force": batch_of(arguments, path, phase),
        "one force, random": batch_of(arguments, anywhere, anywhen),
        "servo tick": _ticks(model, path),
    }
    floor = compiled_floor(model, POSE, law)
    if floor is not None:
        out = np.empty((POINTS, 4))
        for what, places, when in (("floor", path, phase), ("floor, random", anywhere, anywhen)):
            passes[f"C++ {what}"] = partial(_into, floor.forces(places, when), out)
    spent = _alternating(passes)
    rows = tuple(
        row("C++" if what.startswith("C++") else "dvf_ig", what, us, None, calls_per_sample=CALLS)
        for what, us in spent.items()
    )
    median = {one.what: one.median_us for one in rows}
    ratios = {}
    if floor is not None:
        ratios = {
            "one force / C++ floor": median["one force"] / median["C++ floor"],
            "one force / C++ floor, random": median["one force, random"] / median["C++ floor, random"],
            "servo tick / C++ floor": median["servo tick"] / median["C++ floor"],
        }
    return TickCost(rows, ratios)


def _into(function: Callable[[int, int, FloatArray], None], out: FloatArray, begin: int, end: int) -> None:
    function(begin, end, out)


def _alternating(passes: dict[str, Pass]) -> dict[str, FloatArray]:
    """µs a call in blocks of CALLS, of each one's fastest pass; they take turns and so see one machine."""
    best: dict[str, FloatArray] = {}
    for call in passes.values():
        call(0, CALLS)
    for _ in range(PASSES):
        for what, call in passes.items():
            spent = np.empty(POINTS // CALLS)
            for n in range(len(spent)):
                start = time.perf_counter_ns()
                call(n * CALLS, (n + 1) * CALLS)
                spent[n] = time.perf_counter_ns() - start
            spent /= CALLS * 1e3
            if what not in best or np.median(spent) < np.median(best[what]):
                best[what] = spent
    return best


def _ticks(model: DvfModel, tip: FloatArray) -> Pass:
    """Pose, phase, two fixtures, composition, passivity, saturation, supervision; without device and clock.

    The hand goes to and fro on the first 2 s of its path: a jump to another place would latch the force.
    """
    stay = tip[: round(2.0 * RATE_HZ)]
    tip = np.ascontiguousarray(np.tile(np.concatenate([stay, stay[::-1]]), (3, 1))[: len(tip)])
    numbers = np.zeros(1)
    bound = bind_fixtures(Fixtures(model, TWO_FIXTURES), COMMON_DEVICE, ServoOptions(), 0.0)
    scratch = new_scratch(len(TWO_FIXTURES.fixtures))
    inputs = ServoInputs(
        PoseAndPhase(*steady(POSE)), 0.0, Rigid.identity("tracker", "device"), valid_for_s=1e9
    )
    scratch.inputs[:], force = inputs.packed(0.0), np.empty(3)

    def run(i: int, j: int) -> None:
        tick_batch(bound, scratch, tip[i:j], numbers, 1.0 / RATE_HZ, force)

    return run


@kernel
def tick_batch(
    bound: Any,
    scratch: Any,
    xyz_mm: FloatArray,
    ticks: FloatArray,
    period_s: float,
    force: FloatArray,
) -> None:
    """`servo_tick` at (n, 3) positions a period apart; `ticks` counts on."""
    bound, scratch, xyz_mm, force = borrowed(bound), borrowed(scratch), borrowed(xyz_mm), borrowed(force)
    for n in range(len(xyz_mm)):
        servo_tick(bound, scratch, scratch.inputs[0], xyz_mm[n], 0, 1.0 + ticks[0] * period_s, 0, force)
        ticks[0] += 1.0
