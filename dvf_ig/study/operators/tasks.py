"""Manual tracking of a place of the beating surface over 30 cycles (Ren 2008, Figs 14, 15).

Automatic tracking, a stylus in nobody's hand, is `dvf_ig.study.tracking`.
"""

import numpy as np

from data_synth.operator.contact_sites import Site
from data_synth.operator.hand import perpendicular
from data_synth.seeds import child_rng
from dvf_ig.core import FloatArray
from dvf_ig.guidance import Gaussian
from dvf_ig.study.operators.closed_loop import (
    DEVICE,
    Aim,
    Condition,
    Loop,
    OperatingHeart,
    Trace,
    moving_line,
    operator_of,
    run_task,
)
from dvf_ig.study.operators.pellets import guidance_law
from dvf_ig.study.tracking.stylus import BeatingSurface, hold_stylus, with_fixture

CYCLES = 30
TRACK = 0.0
"""Stage."""


def tracking_law() -> Gaussian:
    """The guidance of the automatic kind: of smallest dead band among what the device renders."""
    return guidance_law(0.0)


def automatic(surface: BeatingSurface) -> dict[str, float]:
    """The stylus in nobody's hand, on the same device under the same law, at all places."""
    return hold_stylus(surface, with_fixture(DEVICE, "force", compensate=False), cycles=CYCLES).summary()


def track(heart: OperatingHeart, place: Site, condition: Condition, seed: int) -> Trace:
    """One operator follows one place of the surface."""
    point = moving_line(heart.truth, place, 0.0, 0.0)
    cycle_s = heart.cycle(condition)
    loop = Loop(heart, condition, seed, tracking_law(), point.at(0.0, 0.0), -place.normal, 0.0)
    timing_s = operator_of(loop).timing_error_s

    def task(t_s: float, tip_mm: FloatArray, believed_error_mm: float) -> Aim:
        beat = point.rate_mm(0.0, heart.phase(condition, t_s + timing_s)) / cycle_s
        return Aim(point.at(0.0, heart.phase(condition, t_s)), np.zeros(3), beat, TRACK)

    return run_task(loop, task, CYCLES * cycle_s)


def tracked_place(heart: OperatingHeart, surface: BeatingSurface, seed: int) -> Site:
    """One of the places of the automatic kind, drawn by the operator's seed, and its normal."""
    start = surface.starts_mm[child_rng(seed, "place").integers(len(surface.starts_mm))]
    normal = -heart.truth.distance(start[None], np.zeros(1))[1][0]
    return Site(start, normal, perpendicular(normal, np.array([0.0, 0.0, 1.0])))


def tracking_measures(trace: Trace) -> dict[str, float]:
    """Measures of |distance to the true surface| over all cycles."""
    error = np.abs(trace.depth_mm)
    return {
        "mean_mm": float(error.mean()),
        "rms_mm": float(np.sqrt((error**2).mean())),
        "p95_mm": float(np.percentile(error, 95)),
        "max_mm": float(error.max()),
        "largest_force_n": float(trace.force_n.max()),
        "withheld_s": trace.withheld_s,
    }
