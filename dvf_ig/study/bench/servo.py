"""Lateness of servo loops while Python is busy, what a tick costs, and the floor of one dynamic force in C++.

The floor is `floor.cpp`, compiled for this machine if it has a C++ compiler; all of it is measured in one
run.
"""

import ctypes
import gc
import json
import os
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import RIGID_SIGMA_MM, FloatArray, Grid, Mesh, Rigid, Tissue, Volume, Warp, WarpMotion
from dvf_ig.core.model import DvfModel
from dvf_ig.core.space.warp import CELLS, knots
from dvf_ig.guidance import Evaluator, Gaussian, Hazard, PathTarget, PoseAndPhase, Sigmoid, Status
from dvf_ig.guidance.device import COMMON_DEVICE
from dvf_ig.guidance.devices.recorded import RecordedDevice
from dvf_ig.guidance.fixtures import FixtureOptions, Fixtures, FixtureSet
from dvf_ig.guidance.servo import Deadlines, Servo, ServoInputs, ServoOptions, TrackedServo
from dvf_ig.guidance.servo.bound import bind_fixtures
from dvf_ig.guidance.servo.inputs import Publication
from dvf_ig.guidance.servo.record import BINS, deadlines_of
from dvf_ig.guidance.servo.servo import real_time_thread
from dvf_ig.guidance.tissue import Feel, feel_of
from dvf_ig.guidance.tool import Fulcrum, Tool
from dvf_ig.kernels.compiled import kernel
from dvf_ig.kernels.pose_and_phase import GUIDED_SIZE, guided_batch
from dvf_ig.kernels.servo import loop, shared
from dvf_ig.kernels.servo.borrowed import borrowed, placed
from dvf_ig.kernels.servo.layout import new_scratch
from dvf_ig.kernels.servo.tick import servo_tick
from dvf_ig.preop.tissue import LABEL_MM
from dvf_ig.study.bench.calls import POSE, batch_of, steady
from dvf_ig.study.bench.timing import CYCLE_S, RATE_HZ, Row, hand_path, random_points, row

SOURCE = Path(__file__).with_name("floor.cpp")
FLAGS = ("-O3", "-march=native", "-ffast-math", "-fPIC", "-c")


class CppFloor:
    """The compiled floor, bound to a model with evenly spaced phases and a sigmoid at the surface."""

    def __init__(self, library: ctypes.CDLL, model: DvfModel, model_from_query: Rigid, law: Sigmoid) -> None:
        self._function = library.dynamic_forces
        self._arrays = (
            model.coefficients.copy(),
            np.array(model.coefficients.shape, dtype=np.int32),
            np.array(model.origin_mm),
            np.ascontiguousarray(model_from_query.matrix[:3]),
        )
        self._per_knot, self._law = 1.0 / float(model.knot_spacing_mm), law

    def forces(self, xyz_mm: FloatArray, phase: FloatArray, out: FloatArray) -> Callable[[int, int], None]:
        """A function of begin and end that puts forces (N) and distance (mm) at those points into (n, 4)."""
        c, shape, origin, pose = (a.ctypes.data_as(ctypes.c_void_p) for a in self._arrays)
        xyz, phi = (np.ascontiguousarray(a) for a in (xyz_mm, phase))
        numbers = (ctypes.c_double(self._law.gamma_per_mm), ctypes.c_double(self._law.cap_n))
        data = (xyz.ctypes.data_as(ctypes.c_void_p), phi.ctypes.data_as(ctypes.c_void_p))
        per_knot, function = ctypes.c_double(self._per_knot), self._function

        place = out.ctypes.data_as(ctypes.c_void_p)

        def run(begin: int, end: int) -> None:
            span = (ctypes.c_long(begin), ctypes.c_long(end))
            function(c, shape, origin, per_knot, pose, *numbers, *data, *span, place)

        run.__dict__["kept"] = (xyz, phi, out, self)
        return run


def compiled_floor(model: DvfModel, model_from_query: Rigid, law: Sigmoid) -> CppFloor | None:
    """The floor; None if there is no C++ compiler."""
    compiler = shutil.which(os.environ.get("CXX", "g++")) or shutil.which("c++")
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        compiled, library = Path(folder) / "floor.o", Path(folder) / "floor.so"
        # linked without -ffast-math: gcc would make the whole process flush subnormal numbers to zero
        for step in (
            [compiler, *FLAGS, str(SOURCE), "-o", str(compiled)],
            [compiler, "-shared", str(compiled), "-o", str(library)],
        ):
            if subprocess.run(step, capture_output=True, check=False).returncode != 0:
                return None
        return CppFloor(ctypes.CDLL(str(library)), model, model_from_query, law)


TOUCHING = 0.2
"""Share of the way to the heart's centre by which a hand's path is moved, so that it is within the tissue."""
PUBLISH_S = 1.0 / 30.0
RATES_HZ = (1000.0, 4000.0)
TWO_FIXTURES = FixtureSet(
    (
        FixtureOptions(Sigmoid(depth_mm=1.0), name="wall"),
        FixtureOptions(Gaussian(6.0, 1.0, cap_n=0.4), name="surface"),
    )
)
"""A forbidden region and guidance to the surface: what the ticks evaluate."""


@dataclass(frozen=True, slots=True)
class ServoBench:
    """Result of `dvf-ig bench --servo`.

    Attributes:
        rows: lateness of each loop, µs.
        ticks, due: by row, ticks that ran and deadlines that there were.
        forced_ticks: by row, ticks of the servos that sent a force.
        realtime: the machine gave the loops a real-time priority.
        python_p99_ratio: p99 of the Python thread over that of the servo at 1 kHz.
    """

    rows: tuple[Row, ...]
    ticks: dict[str, int]
    due: dict[str, int]
    forced_ticks: dict[str, int]
    realtime: bool
    python_p99_ratio: float


def bench_servo(
    model: DvfModel, seconds: float, seed: int, progress: Callable[[float], None] | None = None
) -> ServoBench:
    """Measure each loop for `seconds`, one after the other, under the same load."""
    mesh = model.reference[model.ed_phase]
    fixtures = Fixtures(model, TWO_FIXTURES)
    rows: list[Row] = []
    ticks: dict[str, int] = {}
    due: dict[str, int] = {}
    forced: dict[str, int] = {}
    realtime = True

    def add(name: str, what: str, deadlines: Deadlines, at: int) -> None:
        rows.append(_row(name, what, deadlines))
        ticks[what], due[what] = deadlines.ticks, deadlines.ticks + deadlines.skipped
        if progress is not None:
            progress(at / 5.0)

    add("machine", "servo floor", _floor(seconds, 1000.0), 1)
    for k, rate_hz in enumerate(RATES_HZ):
        what = f"servo {rate_hz / 1e3:.0f} kHz"
        deadlines, pushed, granted = _servo(fixtures, mesh, seconds, rate_hz, seed)
        add("dvf_ig", what, deadlines, k + 2)
        forced[what], realtime = pushed, realtime and granted
    add("machine", "servo floor, 4 kHz", _floor(seconds, 4000.0), 4)
    add("python", "servo python thread", _python_thread(fixtures, mesh, seconds, seed), 5)
    p99 = {row.what: row.p99_us for row in rows}
    return ServoBench(
        tuple(rows), ticks, due, forced, realtime, p99["servo python thread"] / p99["servo 1 kHz"]
    )


def burn(seconds: float, often: Callable[[], None]) -> None:
    """Pure Python, JSON and garbage collection until the time is over, and `often` now and then.

    All of it holds the GIL; the collector runs over many objects that refer to one another.
    """
    end = time.monotonic() + seconds
    due = 0.0
    garbage: list[dict[str, object]] = []
    while (now := time.monotonic()) < end:
        if now >= due:
            often()
            due = now + PUBLISH_S
        cycle: dict[str, object] = {str(k): [k, {"squared": k * k}] for k in range(300)}
        cycle["itself"] = cycle
        garbage.append(cycle)
        json.loads(json.dumps({str(k): list(range(10)) for k in range(50)}))
        if len(garbage) > 30:
            garbage.clear()
            gc.collect()


def _servo(
    fixtures: Fixtures, mesh: Mesh, seconds: float, rate_hz: float, seed: int
) -> tuple[Deadlines, int, bool]:
    """Deadlines, ticks that sent a force, whether the loop had real-time priority."""
    device = _moving_hand(mesh, seconds, seed)
    begin = time.monotonic()
    transform = _steady_transform(fixtures.model)
    forced = 0
    with Servo(fixtures, device, options=ServoOptions(rate_hz=rate_hz)) as servo:

        def speak() -> None:
            nonlocal forced
            servo.publish(
                ServoInputs(transform, time.monotonic() - begin, Rigid.identity("tracker", "device"))
            )
            forced += int((np.abs(servo.read().sent_n).max(axis=1, initial=0.0) > 0.0).sum())

        burn(seconds, speak)
    return servo.deadlines, forced, servo.realtime


def _floor(seconds: float, rate_hz: float) -> Deadlines:
    numbers, histogram = np.zeros(loop.NUMBERS, dtype=np.int64), np.zeros(BINS, dtype=np.int64)
    stopped = numbers.copy()
    stopped[loop.STOP] = 1
    period_ns = round(1e9 / rate_hz)
    loop.measure_floor(stopped, histogram, period_ns)
    thread, _ = real_time_thread("dvf-ig floor", loop.measure_floor, numbers, histogram, period_ns)
    burn(seconds, lambda: None)
    shared.store_number(numbers, loop.STOP, 1)
    thread.join()
    return Deadlines(histogram, float(numbers[loop.WORST_NS]) / 1e3, int(numbers[loop.SKIPPED]))


def _python_thread(fixtures: Fixtures, mesh: Mesh, seconds: float, seed: int) -> Deadlines:
    """Step the fixtures and the supervisor from a Python thread of the same priority."""
    path = hand_path(mesh, round(seconds * 1000.0) + 1000, np.random.default_rng(seed))
    late: list[float] = []
    skipped = 0
    stop = threading.Event()
    servo, transform = TrackedServo(fixtures), _steady_transform(fixtures.model)
    still, nothing = np.zeros(3), np.zeros(0)

    def ticks() -> None:
        nonlocal skipped
        begin = time.monotonic()
        due = 0
        while not stop.is_set():
            due += 1
            now = time.monotonic() - begin
            if now < due * 1e-3:
                time.sleep(due * 1e-3 - now)
                now = time.monotonic() - begin
            late.append(1e6 * (now - due * 1e-3))
            servo.step(now, transform, Hazard.NONE, Status.OK, nothing, (path[due % len(path)], still))
            passed = int((time.monotonic() - begin) / 1e-3) - due
            if passed > 0:
                skipped += passed
                due += passed

    thread, _ = real_time_thread("python servo", ticks)
    burn(seconds, lambda: None)
    stop.set()
    thread.join()
    return deadlines_of(np.array(late), skipped)


def _moving_hand(mesh: Mesh, seconds: float, seed: int) -> RecordedDevice:
    """A hand's path about the heart; longer than the run, whose servo starts a little earlier."""
    path = hand_path(mesh, round((seconds + 5.0) * 1000.0), np.random.default_rng(seed))
    return RecordedDevice(path, 1000.0)


def _steady_transform(model: DvfModel) -> PoseAndPhase:
    return PoseAndPhase(*steady(Rigid.identity(model.frame, "tracker")))


def _row(name: str, what: str, deadlines: Deadlines) -> Row:
    median, p99, p999 = (deadlines.percentile_us(p) for p in (50.0, 99.0, 99.9))
    note = f"{deadlines.ticks} of {deadlines.ticks + deadlines.skipped} ticks"
    return Row(name, what, median, p99, p999, deadlines.worst_us, None, 1, note)


PATH_POINTS = 20
SHAFT_MM = 60.0
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
    touching = path + TOUCHING * (back.apply_array(mesh.vertices_mm).mean(axis=0) - path)
    anywhere = np.ascontiguousarray(back.apply_array(random_points(mesh, POINTS, rng)))
    phase = (np.arange(POINTS) / (RATE_HZ * CYCLE_S)) % 1.0
    anywhen = rng.uniform(size=POINTS)
    law = Sigmoid()
    arguments = Evaluator(model, law).kernel_arguments(POSE)
    passes: dict[str, Pass] = {
        "one force": batch_of(arguments, path, phase),
        "one force, random": batch_of(arguments, anywhere, anywhen),
        "one guided force": _guided(model, path, None),
        "one guided force, warped": _guided(model, path, _warp(model)),
        "servo tick": _ticks(model, path, None),
        "servo tick, warped": _ticks(model, path, _warp(model)),
        "servo tick, tissue": _ticks(model, touching, None, feel=_feel(model)),
        "servo tick, tissue, warped": _ticks(model, touching, _warp(model), feel=_feel(model)),
        "servo tick, two structures and a path": _ticks(model, path, None, _two_structures(model)),
        "servo tick, shaft": _ticks(model, path, None, replace(TWO_FIXTURES, tool=_away(model, path))),
        "servo tick, shaft along the wall": _ticks(
            model, path, None, replace(TWO_FIXTURES, tool=Tool(shaft_mm=SHAFT_MM, axis=_along(model, path)))
        ),
    }
    floor = compiled_floor(model, POSE, law)
    if floor is not None:
        out = np.empty((POINTS, 4))
        for what, places, when in (("floor", path, phase), ("floor, random", anywhere, anywhen)):
            passes[f"C++ {what}"] = floor.forces(places, when, out)
    spent = _alternating(passes)
    rows = tuple(
        row("C++" if what.startswith("C++") else "dvf_ig", what, us, None, calls_per_sample=CALLS)
        for what, us in spent.items()
    )
    median = {one.what: one.median_us for one in rows}
    ratios = {
        "one guided force, warped / plain": median["one guided force, warped"] / median["one guided force"],
        "servo tick, warped / plain": median["servo tick, warped"] / median["servo tick"],
        "servo tick, two structures and a path / plain": median["servo tick, two structures and a path"]
        / median["servo tick"],
        "servo tick, shaft / plain": median["servo tick, shaft"] / median["servo tick"],
        "servo tick, shaft along the wall / plain": median["servo tick, shaft along the wall"]
        / median["servo tick"],
    }
    if floor is not None:
        ratios |= {
            "one force / C++ floor": median["one force"] / median["C++ floor"],
            "one force / C++ floor, random": median["one force, random"] / median["C++ floor, random"],
            "servo tick / C++ floor": median["servo tick"] / median["C++ floor"],
        }
    return TickCost(rows, ratios)


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


def _warp(model: DvfModel) -> WarpMotion:
    """A heart that is 2 mm fuller."""
    vertices = model.reference[model.ed_phase].vertices_mm
    center, pitch = vertices.mean(axis=0), 0.1 * float(np.ptp(vertices, axis=0).max()) + 5.0
    origin = center - 0.5 * CELLS * pitch
    away = knots(origin, pitch) - center
    variance = np.full(len(away), RIGID_SIGMA_MM**2)
    return WarpMotion.still(Warp.through(model.frame, origin, pitch, 0.05 * away, variance))


def _feel(model: DvfModel) -> Feel:
    """Tissue of two kinds that moves a little; what it is does not matter to the time of a tick."""
    corners = model.reference[model.ed_phase].vertices_mm
    low, side_mm = corners.min(axis=0) - 6.0, float(np.ptp(corners, axis=0).max()) + 12.0
    count = round(side_mm / LABEL_MM)
    grid = Grid.axis_aligned(model.frame, (count,) * 3, low, LABEL_MM)
    kinds = 1 + (np.indices(grid.shape).sum(axis=0) // 8) % 2
    places, nothing = knots(low, side_mm / CELLS), np.zeros((CELLS + 1) ** 3)
    motion = [
        Warp.through(model.frame, low, side_mm / CELLS, np.sin(places / 30.0 + k), nothing)
        for k in range(model.phases)
    ]
    tissue = Tissue(Volume(grid, kinds.astype(np.uint8)), ((1, "myocardium"), (2, "vessel")), tuple(motion))
    return feel_of(replace(model, tissue=tissue), COMMON_DEVICE)


def _guided(model: DvfModel, tip: FloatArray, warp: WarpMotion | None) -> Pass:
    """Force at a tip and time, through pose, phase and perhaps a change of shape; with rates and σ_d."""
    t_s, status = np.arange(len(tip)) / RATE_HZ, np.zeros(len(tip), dtype=np.int64)
    out = np.empty((len(tip), GUIDED_SIZE))
    arguments = PoseAndPhase(*steady(POSE), warp=warp).bind(Evaluator(model, Sigmoid())).args
    batch: Callable[..., None] = guided_batch

    def run(i: int, j: int) -> None:
        batch(*arguments, t_s[i:j], tip[i:j], status[i:j], out[i:j])

    return run


def _from_heart(model: DvfModel, tip: FloatArray) -> FloatArray:
    """Unit vector (3,) from the heart's middle to the begin of a path of the tip."""
    middle = POSE.inverse().apply_array(model.reference[model.ed_phase].vertices_mm).mean(axis=0)
    return np.asarray((tip[0] - middle) / np.linalg.norm(tip[0] - middle))


def _away(model: DvfModel, tip: FloatArray) -> Tool:
    """A shaft that leads away from the heart to a trocar."""
    return Tool(shaft_mm=SHAFT_MM, fulcrum=Fulcrum(tip[0] + 150.0 * _from_heart(model, tip), 350.0))


def _along(model: DvfModel, tip: FloatArray) -> FloatArray:
    """A direction (3,) along the heart's wall at the begin of a path of the tip."""
    normal = _from_heart(model, tip)
    return np.cross(normal, np.eye(3)[int(np.abs(normal).argmin())])


def _two_structures(model: DvfModel) -> FixtureSet:
    """A wall on the heart, one on a second beating structure, and a path that beats with it."""
    other = replace(model, surface_name="second")
    path = PathTarget.beating(other, model.reference[model.ed_phase].vertices_mm[:PATH_POINTS])
    return FixtureSet(
        (
            FixtureOptions(Sigmoid(depth_mm=1.0), name="wall"),
            FixtureOptions(Sigmoid(depth_mm=5.0), name="second wall", structure=other),
            FixtureOptions(Gaussian(6.0, 1.0, cap_n=0.4), path=path, name="path", structure=other),
        )
    )


def _ticks(
    model: DvfModel,
    tip: FloatArray,
    warp: WarpMotion | None,
    fixtures: FixtureSet = TWO_FIXTURES,
    feel: Feel | None = None,
) -> Pass:
    """Pose, phase, fixtures, composition, passivity, saturation, supervision; without device and clock.

    The hand goes to and fro on the first 2 s of its path: a jump to another place would latch the force.
    """
    stay = tip[: round(2.0 * RATE_HZ)]
    tip = np.ascontiguousarray(np.tile(np.concatenate([stay, stay[::-1]]), (3, 1))[: len(tip)])
    numbers = np.zeros(1)
    bound = bind_fixtures(Fixtures(model, fixtures), COMMON_DEVICE, ServoOptions(feel=feel), 0.0)
    scratch = new_scratch(len(fixtures.fixtures))
    inputs = ServoInputs(
        PoseAndPhase(*steady(POSE), warp=warp),
        0.0,
        Rigid.identity("tracker", "device"),
        valid_for_s=1e9,
        tool_axis=np.zeros(3) if fixtures.tool.axis is None else fixtures.tool.axis,
    )
    publication, force = Publication(), np.empty(3)
    publication.set(inputs, 0.0)
    scratch.input_words[:] = publication.words

    def run(i: int, j: int) -> None:
        tick_batch(bound, scratch, tip[i:j], numbers, 1.0 / RATE_HZ, force)

    return run


@kernel
def tick_batch(
    bound: Any, scratch: Any, xyz_mm: FloatArray, ticks: FloatArray, period_s: float, force: FloatArray
) -> None:
    """`servo_tick` at (n, 3) positions a period apart; `ticks` counts on."""
    bound, scratch, xyz_mm, force = borrowed(bound), borrowed(scratch), borrowed(xyz_mm), borrowed(force)
    bound_at, scratch_at = placed(bound), placed(scratch)
    for n in range(len(xyz_mm)):
        servo_tick(bound_at, scratch_at, scratch.inputs[0], xyz_mm[n], 0, 1.0 + ticks[0] * period_s, 0, force)
        ticks[0] += 1.0
