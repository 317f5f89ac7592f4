"""Static and dynamic forces timed in kernels, from Python and in batches, ours and others'."""

import math
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import DvfModel, FloatArray, PhaseForecast, PhaseState, PoseMotion, RetimingCurve, Rigid
from dvf_ig.core.errors import InvalidInputError
from dvf_ig.guidance import Continuity, Evaluator, Gaussian, PoseAndPhase, Sigmoid, Status, check_continuity
from dvf_ig.guidance.blend import BLEND_CODES
from dvf_ig.kernels.compiled import kernel
from dvf_ig.kernels.dynamic import force_batch, force_tick
from dvf_ig.kernels.pose_and_phase import GUIDED_SIZE
from dvf_ig.kernels.spline import spline_at, spline_batch
from dvf_ig.preop import build_triangle_tree
from dvf_ig.study.bench.peers import STATIC, TREE, TREE_KERNEL, peer_rows, signs
from dvf_ig.study.bench.timing import (
    CYCLE_S,
    KERNEL_CALLS,
    RATE_HZ,
    Row,
    hand_path,
    random_points,
    row,
    time_batches,
    time_calls,
)


@kernel
def spline_tick(
    coefficients: NDArray[np.float32], box: FloatArray, phase: int, xyz_mm: FloatArray, out: FloatArray
) -> int:
    """Distance and gradient of one phase at one point.

    Args:
        coefficients: (n, cx, cy, cz) mm.
        box: (4,) origin in mm, knot pitch in mm.
        phase: index of the phase, not checked.
        xyz_mm: (3,) point in the model's frame.
        out: (4,) distance in mm and its gradient; NaN unless the status is OK.
    Returns:
        status code.
    """
    q = (xyz_mm[0], xyz_mm[1], xyz_mm[2])
    status, out[0], out[1], out[2], out[3] = spline_at(coefficients, box, 1.0 / box[3], phase, q)
    return status


@kernel
def no_operation(number: int) -> int:
    """Least cost of a call from Python."""
    return number


OURS = "dvf_ig"
POSE = Rigid.from_rotation_vector([0.4, -1.1, 0.7], [30.0, -80.0, 12.0], "mr", "tracker")
"""Any registration costs the same."""
FIRST_CALL = """
import time, numpy as np
from dvf_ig.kernels.dynamic import force_tick as tick
from dvf_ig.kernels.fixture_field import packed_fixture
c, n = np.zeros((2, 4, 4, 4), np.float32), np.zeros(3)
packed = packed_fixture(n, 1.0, np.array([0.0, 0.5]), np.zeros((0, 4, 4)), np.ones(5), 0, None, np.eye(3, 4))
start = time.perf_counter()
tick(c, packed, n, 0.1, 0, np.empty(7))
print(time.perf_counter() - start)
"""


@dataclass(frozen=True, slots=True)
class BenchOptions:
    """How much is timed.

    Attributes:
        calls: points of the path, one a millisecond.
        repeats: passes over the path; the fastest counts.
        batch: points in a batch.
        peers: whether to time other libraries too.
        seed: of the path.
    """

    calls: int = 10_000
    repeats: int = 5
    batch: int = 5_000
    peers: bool = True
    seed: int = 1

    def __post_init__(self) -> None:
        if self.calls < KERNEL_CALLS:
            raise InvalidInputError(f"{self.calls} calls asked for; needed at least {KERNEL_CALLS}")
        if self.repeats < 1 or self.batch < 1:
            raise InvalidInputError("repeats and batch must be at least 1")


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """Result of `dvf-ig bench`.

    Attributes:
        rows: one a thing timed.
        first_call_s: first force of a new process whose kernels were compiled before.
        vertices, triangles, phases, megabytes: of the heart.
        near_error_mm: RMS error of our static distance within 2 mm of the surface.
    """

    rows: tuple[Row, ...]
    first_call_s: float
    vertices: int
    triangles: int
    phases: int
    megabytes: float
    near_error_mm: float

    def ratios(self) -> dict[str, float]:
        """How many times quicker our call is than theirs, by medians of this run."""
        ours = {r.what: r.median_us for r in self.rows if r.name == OURS}
        theirs = [r for r in self.rows if r.name != OURS]
        out = {
            f"{r.name} / static python": r.median_us / ours["static python"]
            for r in theirs
            if r.what == STATIC
        }
        for kind, mine in ((TREE, "static python"), (TREE_KERNEL, "static kernel")):
            medians = [r.median_us for r in theirs if r.what == kind]
            if medians:
                out[f"best {kind} / {mine}"] = min(medians) / ours[mine]
        out["random static kernel / static kernel"] = ours["random static kernel"] / ours["static kernel"]
        out["random kernel / dynamic kernel"] = ours["random kernel"] / ours["dynamic kernel"]
        return out


def run_bench(model: DvfModel, options: BenchOptions) -> Bench:
    """Time the model against its own end-diastolic mesh, on a hand's path around it."""
    rng = np.random.default_rng(options.seed)
    mesh = model.reference[model.ed_phase]
    path = hand_path(mesh, options.calls, rng)
    scattered = random_points(mesh, options.calls, rng)
    exact = build_triangle_tree(mesh.vertices_mm, mesh.triangles).distance_mm(path)
    static, errors = _static_rows(model, path, scattered, exact * signs(mesh, path), options)
    rows = [
        *static,
        *_dynamic_rows(model, path, scattered, exact, options),
        row("numba", "no-op python", time_calls(no_operation, [(1,)] * options.calls, options.repeats), None),
    ]
    if options.peers:
        rows += peer_rows(mesh, path, exact, batch=min(options.batch, len(path)), repeats=options.repeats)
    return Bench(
        tuple(rows),
        first_call_seconds(),
        len(mesh.vertices_mm),
        len(mesh.triangles),
        model.phases,
        model.megabytes,
        float(np.sqrt(np.mean(errors[exact < 2.0] ** 2))) if (exact < 2.0).any() else float("nan"),
    )


def continuity_checks(model: DvfModel, pairs: int, seed: int) -> list[Continuity]:
    """Every blend with a sigmoid and a Gaussian; nothing for 0 pairs."""
    if pairs == 0:
        return []
    rng = np.random.default_rng(seed)
    laws = (Sigmoid(), Gaussian(3.0, 2.0, depth_mm=1.0))
    return [
        check_continuity(Evaluator(model, law, blend=blend), pairs, rng)
        for law in laws
        for blend in BLEND_CODES
    ]


def first_call_seconds() -> float:
    """Program of the new process; run once before, so that compiled kernels are on disk."""
    seconds = [
        float(
            subprocess.run(
                [sys.executable, "-c", FIRST_CALL], check=True, capture_output=True, text=True
            ).stdout
        )
        for _ in range(2)
    ]
    return min(seconds)


def _static_rows(
    model: DvfModel, path: FloatArray, scattered: FloatArray, exact_mm: FloatArray, options: BenchOptions
) -> tuple[list[Row], FloatArray]:
    """Distance and gradient at end-diastole, and the signed error of each point's distance."""
    n, phase = len(path), model.ed_phase
    coefficients, origin = model.coefficients.copy(), model.origin_mm.copy()
    knot = float(model.knot_spacing_mm)
    value, gradient, status = np.empty(n), np.empty((n, 3)), np.empty(n, dtype=np.int64)
    box, out = np.array([*origin, knot]), np.empty(4)

    def batch(i: int, j: int, points: FloatArray = path) -> None:
        spline_batch(coefficients, origin, knot, phase, points[i:j], value[i:j], gradient[i:j], status[i:j])

    batch(0, n)
    if (status != Status.OK).any():
        raise InvalidInputError(
            "the path leaves the model's box; build the model with a margin of 15 mm or more"
        )
    errors = np.asarray(value - exact_mm)
    rms = float(np.sqrt(np.mean(errors**2)))
    size = min(options.batch, n)
    in_kernel = time_batches(batch, n, KERNEL_CALLS, options.repeats)
    anywhere = time_batches(lambda i, j: batch(i, j, scattered), n, KERNEL_CALLS, options.repeats)
    calls = [(coefficients, box, phase, point, out) for point in path]
    in_batch = time_batches(batch, n, size, options.repeats)
    return [
        row(OURS, "static kernel", in_kernel, rms, calls_per_sample=KERNEL_CALLS, note="with gradient"),
        row(
            OURS, "random static kernel", anywhere, None, calls_per_sample=KERNEL_CALLS, note="with gradient"
        ),
        row(OURS, STATIC, time_calls(spline_tick, calls, options.repeats), rms, note="with gradient"),
        row(OURS, "batch", in_batch, rms, calls_per_sample=size, note="with gradient"),
    ], errors


def _dynamic_rows(
    model: DvfModel, path: FloatArray, scattered: FloatArray, exact_mm: FloatArray, options: BenchOptions
) -> Iterator[Row]:
    """Force from tracker position and phase; the error is that of the distance at end-diastole."""
    phi = (np.arange(len(path)) / (RATE_HZ * CYCLE_S)) % 1.0
    tip = np.ascontiguousarray(POSE.inverse().apply_array(path))
    law = Sigmoid()
    ed = float(model.timing.fractions[model.ed_phase])
    for blend in BLEND_CODES:
        evaluator = Evaluator(model, law, blend=blend)
        pose = Rigid(model.frame, "tracker", POSE.rotation, POSE.translation_mm)
        tick = partial(force_tick, *evaluator.kernel_arguments(pose))
        distance_mm = evaluator.force_through(pose, tip, ed).distance_mm
        error = float(np.sqrt(np.mean((np.abs(distance_mm) - exact_mm) ** 2)))
        suffix = "" if blend == "force" else f", {blend} blend"
        yield _kernel_row(f"dynamic kernel{suffix}", tick.args, tip, phi, error, options)
        out = np.empty(7)
        calls = [(point, at, 0, out) for point, at in zip(tip, phi.tolist(), strict=True)]
        yield row(OURS, f"dynamic python{suffix}", time_calls(tick, calls, options.repeats), error)
        if blend != "force":
            continue
        elsewhere = np.ascontiguousarray(POSE.inverse().apply_array(scattered))
        anywhen = np.random.default_rng(options.seed).uniform(size=len(phi))
        yield _kernel_row("random kernel", tick.args, elsewhere, anywhen, None, options)
        yield from _guided_rows(evaluator, PoseAndPhase(*steady(pose)), tip, error, options)


def _guided_rows(
    evaluator: Evaluator, transform: PoseAndPhase, tip: FloatArray, error_mm: float, options: BenchOptions
) -> Iterator[Row]:
    """Force from tracker position and time, through the pose-and-phase transform."""
    t_s = (np.arange(len(tip)) / RATE_HZ).tolist()
    few = [(evaluator, tip[k : k + 1], t_s[k]) for k in range(min(len(tip), 1000))]
    spent = time_calls(transform.evaluate, few, options.repeats)
    yield row(OURS, "dynamic safe", spent, error_mm, note="PoseAndPhase.evaluate, every argument checked")
    out = np.empty(GUIDED_SIZE)
    calls = [(now, point, 0, out) for point, now in zip(tip, t_s, strict=True)]
    spent = time_calls(transform.bind(evaluator), calls, options.repeats)
    yield row(OURS, "guided python", spent, error_mm, note="pose and phase at t, rates and σ_d included")


def steady(pose: Rigid) -> tuple[PoseMotion, PhaseForecast, RetimingCurve, FloatArray]:
    """A pose that stays, with its covariance, and a heart that beats once in CYCLE_S."""
    beat = PhaseForecast(
        since_s=0.0,
        until_s=math.inf,
        state=PhaseState.LOCKED,
        state_after=PhaseState.LOST,
        phi=0.0,
        r_s=0.0,
        cycles=0.0,
        rr_s=CYCLE_S,
        spread=0.05,
        catch_up=3.0,
        r_timing_s=0.005,
    )
    return PoseMotion.still(pose), beat, RetimingCurve.uniform(), np.eye(6)


def _kernel_row(
    what: str,
    arguments: Sequence[object],
    tip: FloatArray,
    phi: FloatArray,
    error_mm: float | None,
    options: BenchOptions,
) -> Row:
    chunk = batch_of(arguments, tip, phi)
    spent = time_batches(chunk, len(tip), KERNEL_CALLS, options.repeats)
    return row(OURS, what, spent, error_mm, calls_per_sample=KERNEL_CALLS)


def batch_of(arguments: Sequence[object], tip: FloatArray, phi: FloatArray) -> Callable[[int, int], None]:
    """Forces at points i to j of a path, into buffers of its own.

    Args:
        arguments: of `Evaluator.kernel_arguments`.
        tip: (n, 3) mm; phi: (n,) phases.
    """
    n = len(tip)
    force, distance, gradient, rate = np.empty((n, 3)), np.empty(n), np.empty((n, 3)), np.empty(n)
    status = np.zeros(n, dtype=np.int64)
    batch: Callable[..., None] = force_batch

    def run(i: int, j: int) -> None:
        out = (force[i:j], distance[i:j], gradient[i:j], rate[i:j], status[i:j])
        batch(*arguments, tip[i:j], phi[i:j], *out)

    return run
