"""The tasks of Ren 2008: depth-controlled cutting, dissection through a fulcrum, manual tracking.

Cutting is along a line of the epicardium, to a depth and no deeper (Table I); dissection is of ten pellets
above an organ, to which guidance pulls (Tables III and IV); tracking is of a place of the beating surface
over 30 cycles (Figs 14, 15). Automatic tracking, a stylus in nobody's hand, is `dvf_ig.study.tracking`.
"""

from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from data_synth.operator.contact_sites import Site, contact_sites
from data_synth.operator.fulcrum import Fulcrum
from data_synth.operator.hand import minimum_jerk, perpendicular
from data_synth.operator.simulated_operator import RATE_HZ, SimulatedOperator
from data_synth.seeds import child_rng
from dvf_ig.core import FloatArray, read_only_arrays
from dvf_ig.guidance import Gaussian, Sigmoid
from dvf_ig.study.operators.closed_loop import (
    ACCESS,
    DEVICE,
    LIMITS,
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
from dvf_ig.study.tracking.stylus import BeatingSurface, hold_stylus, with_fixture

BACK_MM = 0.2
"""An excursion ends so far on this side of the limit: tremor and sensor steps do not divide it."""


def count_excursions(depth_mm: FloatArray, limit_mm: float) -> int:
    """How often the depth (n,) passes the limit; one excursion lasts until the depth is BACK_MM less."""
    beyond = np.where(depth_mm > limit_mm, 1, np.where(depth_mm < limit_mm - BACK_MM, -1, 0))
    marks = beyond[beyond != 0]
    starts = np.flatnonzero(np.diff(np.concatenate([[-1], marks])) == 2)
    return len(starts)


DEPTH_MM = 5.0
"""Depth of the forbidden surface under the epicardium, and of the requested cut."""
PERFORATION_MM = 1.0
"""An excursion so far beyond the forbidden surface counts as a perforation: assumed."""
CUT_LENGTH_MM = 40.0
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
    """Aims of one cut: down to the depth, then along the line, slower where tip and aim lie apart."""

    def __init__(self, line: MovingLine, above_mm: FloatArray, loop: Loop) -> None:
        self._line, self._above, self._loop = line, above_mm, loop
        self._timing_s = operator_of(loop).timing_error_s
        self._along = 0.0

    def __call__(self, t_s: float, tip_mm: FloatArray, operator: SimulatedOperator) -> Aim:
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
        speed = CUT_SPEED_MM_S / (1.0 + (operator.believed_error_mm / SLOWING_MM) ** 2)
        planned = speed * line.tangent(self._along)
        self._along += speed / RATE_HZ
        return Aim(place, planned, beat, CUT)


def cut(heart: OperatingHeart, condition: Condition, seed: int) -> Trace:
    """One operator's cut."""
    site = cutting_site(heart, seed)
    line = line_to_cut(heart, seed)
    above = (DEPTH_MM + ABOVE_MM) * site.normal
    law = cutting_law()
    loop = Loop(heart, condition, seed, law, line.at(0.0, 0.0) + above, -site.normal, DEPTH_MM)
    return run_task(loop, CuttingTask(line, above, loop), LONGEST_CUT_S)


def cutting_law() -> Sigmoid:
    """The steepest forbidden region that the device renders, guarding DEPTH_MM."""
    cap_n = Sigmoid().cap_n
    return Sigmoid((1.0 - 1e-9) * 4.0 * LIMITS.allowed_stiffness_n_per_mm / cap_n, cap_n, DEPTH_MM)


def cutting_site(heart: OperatingHeart, seed: int) -> Site:
    """Where the operator of that seed cuts."""
    return contact_sites(heart.truth, ACCESS, 1, child_rng(seed, "cut"))[0]


@cache
def line_to_cut(heart: OperatingHeart, seed: int) -> MovingLine:
    """The line that the operator of that seed cuts."""
    return moving_line(heart.truth, cutting_site(heart, seed), CUT_LENGTH_MM, DEPTH_MM)


def cutting_measures(trace: Trace) -> dict[str, float]:
    """Measures of the paper's Table I, while cutting.

    Depth error is the mean of |depth − 5 mm|, RMS its root mean square; excess the largest depth beyond 5 mm.
    """
    cutting = trace.stage == CUT
    depth = trace.depth_mm[cutting]
    return {
        "depth_rms_mm": float(np.sqrt(((depth - DEPTH_MM) ** 2).mean())),
        "depth_error_mm": float(np.abs(depth - DEPTH_MM).mean()),
        "depth_bias_mm": float((depth - DEPTH_MM).mean()),
        "largest_excess_mm": float(max(0.0, (depth - DEPTH_MM).max())),
        "perforations": float(count_excursions(depth, DEPTH_MM + PERFORATION_MM)),
        "time_s": float(cutting.sum() / RATE_HZ),
        "largest_force_n": float(trace.force_n.max()),
        "withheld_s": trace.withheld_s,
    }


PELLETS = 10
HEIGHT_MM = 1.0
"""Height of a pellet's centre above the organ's surface."""
REACH_MM = 1.0
REMOVED_AFTER_S = 0.3
"""A pellet is removed when the tip has stayed so long within so much of its centre."""
GIVEN_UP_S = 8.0
"""After so long at a pellet the operator goes on to the next."""
HOVER_MM = 10.0
SPEED_MM_S = 25.0
DOWN_S, UP_S, SHORTEST_S = 1.2, 0.8, 0.8
ARCH = 0.15
"""Height of the way from one pellet to the next, over its length: the organ is round."""
STRAIGHT = np.zeros(3)
LONGEST_S = 230.0
LENGTH_MM, INSIDE_MM = 330.0, 140.0
"""Length of the instrument, and of its part inside at the first pellet."""
CAMERA_RAD = np.deg2rad(30.0)
"""Between the line of sight and the instrument's way in."""
WAY, WORK = 0.0, 1.0
"""Stages; 1 + the number of the pellet while at work there."""


class Way(NamedTuple):
    """A planned motion from rest to rest.

    Attributes:
        start_mm, end_mm: (3,).
        begin_s: when it starts.
        lasts_s: how long it takes.
        arch_mm: (3,) by which its middle lies off the straight line.
    """

    start_mm: FloatArray
    end_mm: FloatArray
    begin_s: float
    lasts_s: float
    arch_mm: FloatArray = STRAIGHT

    def at(self, t_s: float) -> FloatArray:
        share = float(minimum_jerk(np.array((t_s - self.begin_s) / self.lasts_s)))
        arch = 4.0 * share * (1.0 - share) * self.arch_mm
        return np.asarray(self.start_mm + share * (self.end_mm - self.start_mm) + arch)


class DissectionTask:
    """Aims at one pellet after the other: above it, down, stay until it is removed, up again.

    Attributes:
        removed: of each pellet that the operator has left, whether it was removed.
    """

    def __init__(self, sites: list[Site]) -> None:
        self._sites = sites
        self.removed: list[bool] = []
        self._ways = [Way(hover_mm(sites[0]), pellet_mm(sites[0]), 0.0, DOWN_S)]
        self._arrived_s, self._within = DOWN_S, 0

    def __call__(self, t_s: float, tip_mm: FloatArray, operator: SimulatedOperator) -> Aim:
        here = len(self.removed)
        if here == PELLETS:
            return Aim(tip_mm, np.zeros(3), np.zeros(3), -1.0)
        at_work = t_s >= self._arrived_s
        if at_work:
            self._look(t_s, tip_mm, operator.spec.visual_delay_s)
        while len(self._ways) > 1 and t_s >= self._ways[1].begin_s:
            del self._ways[0]
        way = self._ways[0]
        place = way.at(t_s)
        planned = (way.at(t_s + 1.0 / RATE_HZ) - place) * RATE_HZ
        return Aim(place, planned, np.zeros(3), WORK + here if at_work else WAY)

    def _look(self, t_s: float, tip_mm: FloatArray, sees_late_s: float) -> None:
        """Whether the pellet is removed; then, or after GIVEN_UP_S, on to the next."""
        pellet = pellet_mm(self._sites[len(self.removed)])
        needed = round((REMOVED_AFTER_S + sees_late_s) * RATE_HZ)
        near = float(np.linalg.norm(tip_mm - pellet)) <= REACH_MM
        if self._within < round(REMOVED_AFTER_S * RATE_HZ):
            self._within = self._within + 1 if near else 0
        else:  # removed; the operator has yet to see it
            self._within += 1
        if self._within < needed and t_s < self._arrived_s + GIVEN_UP_S:
            return
        self.removed.append(self._within >= round(REMOVED_AFTER_S * RATE_HZ))
        self._within = 0
        self._leave(t_s)

    def _leave(self, t_s: float) -> None:
        last = self._sites[len(self.removed) - 1]
        following = self._sites[len(self.removed) % PELLETS]
        up, down = hover_mm(last), hover_mm(following)
        apart_mm = float(np.linalg.norm(down - up))
        over_s = max(SHORTEST_S, 1.875 * apart_mm / SPEED_MM_S)
        arch = 0.5 * ARCH * apart_mm * (last.normal + following.normal)
        self._ways = [
            Way(pellet_mm(last), up, t_s, UP_S),
            Way(up, down, t_s + UP_S, over_s, arch),
            Way(down, pellet_mm(following), t_s + UP_S + over_s, DOWN_S),
        ]
        self._arrived_s = t_s + UP_S + over_s + DOWN_S


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Dissection:
    """One operator's dissection.

    Attributes:
        trace: of it.
        removed: of each pellet whether it was removed.
        lever: of the instrument at the first pellet.
    """

    trace: Trace
    removed: tuple[bool, ...]
    lever: float


def dissect(heart: OperatingHeart, condition: Condition, seed: int) -> Dissection:
    """One operator's dissection."""
    sites = contact_sites(heart.truth, ACCESS, PELLETS, child_rng(seed, "pellets"))
    first = pellet_mm(sites[0])
    fulcrum = Fulcrum(first + INSIDE_MM * ACCESS, LENGTH_MM)
    side = perpendicular(ACCESS, np.array([0.0, 0.0, 1.0]))
    sight = -(np.cos(CAMERA_RAD) * ACCESS + np.sin(CAMERA_RAD) * side)
    law = dissection_law()
    task = DissectionTask(sites)
    loop = Loop(heart, condition, seed, law, hover_mm(sites[0]), sight, -HEIGHT_MM, fulcrum)
    trace = run_task(loop, task, LONGEST_S)
    return Dissection(trace, tuple(task.removed), fulcrum.lever(first))


def dissection_law() -> Gaussian:
    """Guidance to the height of the pellets, as in the paper."""
    return replace(tracking_law(), depth_mm=-HEIGHT_MM)


def pellet_mm(site: Site) -> FloatArray:
    """(3,) place of a pellet above its site."""
    return np.asarray(site.point_mm + HEIGHT_MM * site.normal)


def hover_mm(site: Site) -> FloatArray:
    """(3,) place above a pellet from which the tool is lowered to it."""
    return np.asarray(site.point_mm + (HEIGHT_MM + HOVER_MM) * site.normal)


def dissection_measures(dissection: Dissection) -> dict[str, float]:
    """Measures of the paper's Tables III and IV.

    An error is a touch of the organ: an excursion of the tip into it.
    """
    trace = dissection.trace
    inside = np.maximum(trace.depth_mm, 0.0)
    return {
        "removed": float(sum(dissection.removed)),
        "errors": float(count_excursions(trace.depth_mm, 0.0)),
        "violation_mm": float(inside.max()),
        "inside_s": float((inside > 0.0).sum() / RATE_HZ),
        "time_s": float(len(trace.t_s) / RATE_HZ),
        "largest_force_n": float(trace.force_n.max()),
        "withheld_s": trace.withheld_s,
    }


CYCLES = 30
TRACK = 0.0
"""Stage."""


def tracking_law() -> Gaussian:
    """The guidance of the automatic kind: of smallest dead band among what the device renders."""
    return with_fixture(DEVICE, "force", compensate=False).law


def automatic(surface: BeatingSurface) -> dict[str, float]:
    """The stylus in nobody's hand, on the same device under the same law, at all places."""
    return hold_stylus(surface, with_fixture(DEVICE, "force", compensate=False), cycles=CYCLES).summary()


def track(heart: OperatingHeart, place: Site, condition: Condition, seed: int) -> Trace:
    """One operator follows one place of the surface."""
    point = moving_line(heart.truth, place, 0.0, 0.0)
    cycle_s = heart.cycle(condition)
    loop = Loop(heart, condition, seed, tracking_law(), point.at(0.0, 0.0), -place.normal, 0.0)
    timing_s = operator_of(loop).timing_error_s

    def task(t_s: float, tip_mm: FloatArray, operator: SimulatedOperator) -> Aim:
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
