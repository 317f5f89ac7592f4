"""Tasks without pellets: following a line, and tracking a place.

Tracking is of a place of the beating surface over 30 cycles (Figs 14, 15). Automatic tracking, a stylus in
nobody's hand, is `dvf_ig.study.tracking`.
"""

import numpy as np

from data_synth.operator.contact_sites import Site
from data_synth.operator.hand import minimum_jerk, perpendicular
from data_synth.operator.simulated_operator import RATE_HZ
from data_synth.seeds import child_rng
from dvf_ig.core import FloatArray
from dvf_ig.guidance import Gaussian
from dvf_ig.study.operators.closed_loop import (
    DEVICE,
    Aim,
    Condition,
    Loop,
    MovingLine,
    OperatingHeart,
    Trace,
    moving_line,
    operator_of,
    run_task,
)
from dvf_ig.study.operators.pellets import guidance_law
from dvf_ig.study.tracking.stylus import BeatingSurface, hold_stylus, with_fixture

CUT_SPEED_MM_S = 4.0
SLOWING_MM = 2.0
"""The operator moves at half speed where tip and aim are so far apart by what is seen and felt."""
ABOVE_MM = 8.0
"""The tip starts so far above the surface."""
APPROACH_S = 3.0
SETTLE_S = 1.0
"""Between the end of the approach and the beginning of the cut."""
LONGEST_CUT_S = 60.0
APPROACH, CUT = 0.0, 1.0
"""Stages."""


class CuttingTask:
    """Aims along a line: down to it, then along it, slower where tip and aim lie apart."""

    def __init__(self, line: MovingLine, above_mm: FloatArray, loop: Loop) -> None:
        self._line, self._above, self._loop = line, above_mm, loop
        self._timing_s = operator_of(loop).timing_error_s
        self._along = 0.0

    def __call__(self, t_s: float, tip_mm: FloatArray, believed_error_mm: float) -> Aim:
        heart, condition, line = self._loop.heart, self._loop.condition, self._line
        phase = heart.phase(condition, t_s)
        place = line.at(self._along, phase)
        foreseen = heart.phase(condition, t_s + self._timing_s)
        beat = line.rate_mm(self._along, foreseen) / heart.cycle(condition)
        if t_s < APPROACH_S + SETTLE_S:
            down = (minimum_jerk(np.array([t_s, t_s + 1.0 / RATE_HZ]) / APPROACH_S) - 1.0).tolist()
            planned = -(down[1] - down[0]) * RATE_HZ * self._above
            return Aim(place - down[0] * self._above, planned, beat, APPROACH)
        if self._along >= line.length_mm:
            return Aim(place, np.zeros(3), beat, -1.0)
        speed = CUT_SPEED_MM_S / (1.0 + (believed_error_mm / SLOWING_MM) ** 2)
        planned = speed * line.tangent(self._along)
        self._along += speed / RATE_HZ
        return Aim(place, planned, beat, CUT)


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
