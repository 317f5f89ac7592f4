"""Timing of calls and batches, and the heart and the hand that they are timed on."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from data_synth.heart.anatomy import phantom_anatomy
from data_synth.heart.outline import outline
from data_synth.operator.hand import tremor
from data_synth.signals.smooth_noise import smooth_noise
from dvf_ig.core import CycleTiming, DvfModel, FloatArray, Mesh
from dvf_ig.preop import ModelOptions, build_model, random_surface_points

KERNEL_CALLS = 100
"""Calls inside a kernel between two readings of the clock."""


@dataclass(frozen=True, slots=True)
class Row:
    """One thing timed.

    Attributes:
        name: "dvf_ig", or the library.
        what: what was called.
        median_us, p99_us, p999_us, max_us: a call.
        error_mm: RMS error of |distance| re the exact distance to the mesh; None if nothing is measured.
        calls_per_sample: calls between two readings of the clock; the percentiles are over their means.
        note: what else to know.
    """

    name: str
    what: str
    median_us: float
    p99_us: float
    p999_us: float
    max_us: float
    error_mm: float | None
    calls_per_sample: int
    note: str = ""


def clock_overhead_ns(samples: int = 20_000) -> float:
    """Median time between two readings of the clock with nothing in between."""
    clock = time.perf_counter_ns
    spent = np.empty(samples)
    for n in range(samples):
        start = clock()
        spent[n] = clock() - start
    return float(np.median(spent))


def time_calls(call: Callable[..., Any], arguments: Sequence[tuple[Any, ...]], repeats: int) -> FloatArray:
    """(n,) µs of each call from Python, the fastest of several passes, the clock's own time taken off."""
    clock = time.perf_counter_ns
    overhead = clock_overhead_ns()

    def once() -> FloatArray:
        spent = np.empty(len(arguments))
        for n, values in enumerate(arguments):
            start = clock()
            call(*values)
            spent[n] = clock() - start
        return spent

    call(*arguments[0])
    return np.maximum(_fastest(once, repeats) - overhead, 0.0) / 1e3


def time_batches(batch: Callable[[int, int], Any], count: int, size: int, repeats: int) -> FloatArray:
    """µs a point in each of count / size batches; `batch(begin, end)` does the points of one."""
    clock = time.perf_counter_ns
    begins = range(0, max(count - size, 0) + 1, size)

    def once() -> FloatArray:
        spent = np.empty(len(begins))
        for n, begin in enumerate(begins):
            start = clock()
            batch(begin, begin + size)
            spent[n] = clock() - start
        return spent

    batch(0, size)
    return _fastest(once, repeats) / (size * 1e3)


def row(
    name: str,
    what: str,
    spent_us: FloatArray,
    error_mm: float | None,
    *,
    calls_per_sample: int = 1,
    note: str = "",
) -> Row:
    """The row of a timing."""
    median, p99, p999 = (float(v) for v in np.percentile(spent_us, [50.0, 99.0, 99.9]))
    return Row(name, what, median, p99, p999, float(spent_us.max()), error_mm, calls_per_sample, note)


def _fastest(once: Callable[[], FloatArray], repeats: int) -> FloatArray:
    """The pass with the smallest median: other programs only ever lengthen it."""
    return min((once() for _ in range(repeats)), key=lambda spent: float(np.median(spent)))


RATE_HZ = 1000.0
REACH_MM = 15.0
"""How far from the surface a query may be."""
HAND_HZ = (0.2, 3.0)
HAND_RMS_MM = 5.0
STAY_S = 2.0
"""How long the hand works at one place of the surface."""
CYCLE_S = 0.86


def bench_model(
    *,
    step_mm: float = 1.5,
    phases: int = 20,
    seed: int = 1,
    threads: int = 2,
    progress: Callable[[float], None] | None = None,
) -> DvfModel:
    """The phantom's beating epicardium, meshed as finely as a clinical surface.

    Args:
        step_mm: pitch of the marching cubes; 1.5 mm gives the 34 000 vertices of the paper's heart.
        phases: volumes in the cycle.
        seed: of the phantom's shape.
    """
    anatomy = phantom_anatomy(motion="paper5mm", mismatch_mm=0.0, seed=seed)
    vertices, triangles = outline(anatomy.shapes.organ, anatomy.shapes.center_mm, step_mm)
    meshes = [Mesh("mr", anatomy.deformed(vertices, i / phases), triangles) for i in range(phases)]
    return build_model(
        meshes,
        [np.zeros(len(triangles), dtype=np.bool_) for _ in meshes],
        CycleTiming.uniform(phases, CYCLE_S),
        patient_id=f"phantom-{seed}",
        surface_name="EPICARDIAL",
        options=ModelOptions(threads=threads),
        progress=progress,
        sources=(f"phantom, seed {seed}, meshed at {step_mm:g} mm",),
    )


def hand_path(mesh: Mesh, samples: int, rng: np.random.Generator) -> FloatArray:
    """(n, 3) positions of a working hand, one a millisecond, at most 15 mm from the surface.

    Smooth motion up to 3 Hz and physiological tremor around a place of the surface; another place every 2 s.
    """
    t_s = np.arange(samples) / RATE_HZ
    offset = HAND_RMS_MM * smooth_noise(3, *HAND_HZ, rng)(t_s) + tremor(rng)(t_s)
    stay = (t_s / STAY_S).astype(np.int64)
    places, _ = random_surface_points(mesh, int(stay[-1]) + 1, rng)
    return np.ascontiguousarray(places[stay] + _within_reach(offset))


def random_points(mesh: Mesh, samples: int, rng: np.random.Generator) -> FloatArray:
    """(n, 3) points up to 15 mm from random places of the surface, no two related."""
    places, _ = random_surface_points(mesh, samples, rng)
    direction = rng.normal(size=(samples, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.ascontiguousarray(places + direction * rng.uniform(0.0, REACH_MM, (samples, 1)))


def _within_reach(offset: FloatArray) -> FloatArray:
    """Offsets longer than the reach, shortened to it."""
    length = np.linalg.norm(offset, axis=1, keepdims=True)
    return np.asarray(offset * np.minimum(1.0, REACH_MM / np.maximum(length, 1e-9)))
