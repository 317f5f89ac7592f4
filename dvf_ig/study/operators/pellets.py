"""Ren 2008's tasks with ten pellets: pushed 5 mm into the heart (Table I), removed above it (Tables III, IV).

Rules and plan are apart: the rules, which look at the tip alone, hold for people as for simulated operators;
the plan says where a simulated operator aims.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from data_synth.operator.contact_sites import Site, contact_sites
from data_synth.operator.fulcrum import Fulcrum
from data_synth.operator.hand import minimum_jerk, perpendicular
from data_synth.operator.simulated_operator import RATE_HZ
from data_synth.seeds import child_rng
from dvf_ig.core import FloatArray, read_only_arrays
from dvf_ig.guidance import DeviceLimits, Gaussian, Law, Sigmoid, SimulatedDevice, tightest_gaussian
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
    moving_points,
    operator_of,
    run_task,
)

PELLETS = 10
DEPTH_MM = 5.0
"""Depth to which a pellet is to be pushed, and of the forbidden surface under the epicardium."""
PERFORATION_MM = 1.0
"""A pellet pushed so far beyond the forbidden surface counts as a perforation: assumed."""
HEIGHT_MM = 1.0
"""Height above the surface of the centre of a pellet that is to be removed."""
REACH_MM, REMOVED_AFTER_S = 1.0, 0.3
"""A pellet is removed when the tip has stayed so long within so much of its centre."""
BESIDE_MM, CLEAR_MM = 12.0, 3.0
"""A tip further from the target than the first does not push its pellet; when it is the second above the
surface again, the pellet stays where it was pushed to."""
HOLD_S = 0.5
"""A simulated operator holds the tip at the depth so long."""
ABOVE_MM = {"cutting": DEPTH_MM + 8.0, "dissection": 10.0}
"""Height above the target from which the tool is lowered."""
SPEED_MM_S = 25.0
DOWN_S, UP_S, SHORTEST_S = 1.2, 0.8, 0.8
ARCH = 0.15
"""Height of the way from one pellet to the next, over its length: the organ is round."""
LONGEST_S = 235.0
LENGTH_MM, INSIDE_MM = 330.0, 140.0
"""Length of the instrument, and of its part inside at the first pellet."""
FULCRA, TILT_RAD = 5, math.radians(15.0)
"""Fulcra, of which a trial has one, and their tilt from the way in: assumed."""
CAMERA_RAD = math.radians(30.0)
"""Between the line of sight and the way in, with a fulcrum."""
WAY, WORK = 0.0, 1.0
"""Stages; WORK + the number of the pellet while at work there."""
STRAIGHT = np.zeros(3)


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


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Pellets:
    """Pellets of a trial.

    Attributes:
        sites: below them; moving: targets of the tip, which beat.
        above_mm: from a target to where the tool is lowered from.
    """

    sites: tuple[Site, ...]
    moving: MovingLine
    above_mm: float

    def target_mm(self, number: int, phase: float = 0.0) -> FloatArray:
        """(3,) where the tip should go."""
        return self.moving.at(float(number), phase)

    def hover_mm(self, number: int) -> FloatArray:
        """(3,) place from which the tool is lowered, at phase 0."""
        return np.asarray(self.target_mm(number) + self.above_mm * self.sites[number].normal)


def pellets_of(heart: OperatingHeart, task: str, seed: int, number: int) -> Pellets:
    """Draw the pellets of an operator's trial."""
    sites = contact_sites(heart.truth, ACCESS, PELLETS, child_rng(seed, f"pellets {number}"))
    depth_mm = DEPTH_MM if task == "cutting" else -HEIGHT_MM
    moving = moving_points(heart.truth, np.array([site.point_mm for site in sites]), depth_mm)
    return Pellets(tuple(sites), moving, ABOVE_MM[task])


class PelletTask:
    """Aims at one pellet after the other: above it, down, stay, up again; until all are done.

    Args:
        pellets, loop: of the trial.
        holds_s: after arriving the plan goes up again, whatever happened; None: once it is seen that the
            pellet is done.
    Attributes:
        done: number of pellets that are done.
    """

    def __init__(self, pellets: Pellets, loop: Loop, holds_s: float | None = None) -> None:
        self.pellets, self.done = pellets, 0
        self._heart, self._condition, self._operator = loop.heart, loop.condition, operator_of(loop)
        self._at, self._holds_s, self._over_s = 0, holds_s, math.inf
        self._ways: list[Way] = []
        self._plan([Way(pellets.hover_mm(0), pellets.target_mm(0), 0.0, DOWN_S)])

    def __call__(self, t_s: float, tip_mm: FloatArray, believed_error_mm: float) -> Aim:
        phase, before = self._heart.phase(self._condition, t_s), self.done
        stage = self._look(tip_mm, phase)
        if self.done == len(self.pellets.sites):
            return Aim(tip_mm, np.zeros(3), np.zeros(3), -1.0)
        if self._holds_s is None and self.done > before:
            self._up_s = t_s + self._operator.visual_delay_s
        if t_s >= self._up_s:
            up = Way(self._ways[0].end_mm, self.pellets.hover_mm(self._at), t_s, UP_S)
            self._ways, self._up_s, self._over_s = [up], math.inf, t_s + UP_S
        if t_s >= self._over_s:
            self._go_over(t_s)
        while len(self._ways) > 1 and t_s >= self._ways[1].begin_s:
            del self._ways[0]
        place, soon = (self._ways[0].at(t) for t in (t_s, t_s + 1.0 / RATE_HZ))
        target = self.pellets.target_mm
        foreseen = self._heart.phase(self._condition, t_s + self._operator.timing_error_s)
        beat = self.pellets.moving.rate_mm(float(self._at), foreseen) / self._heart.cycle(self._condition)
        moved = target(self._at, phase) - target(self._at)
        return Aim(place + moved, (soon - place) * RATE_HZ, beat, stage)

    def _look(self, tip_mm: FloatArray, phase: float) -> float:
        """Apply the rules to the tip: return the stage, and count the pellet if it is done."""
        raise NotImplementedError

    def _plan(self, ways: list[Way]) -> None:
        self._ways, self._over_s = ways, math.inf
        arrives_s = ways[-1].begin_s + ways[-1].lasts_s
        self._up_s = math.inf if self._holds_s is None else arrives_s + self._holds_s

    def _go_over(self, t_s: float) -> None:
        """Plan the way to the next pellet, or down to the same one again."""
        last, self._at = self._at, self.done
        start, end = self.pellets.hover_mm(last), self.pellets.hover_mm(self._at)
        apart_mm = float(np.linalg.norm(end - start))
        lasts_s = max(SHORTEST_S, 1.875 * apart_mm / SPEED_MM_S)
        normals = self.pellets.sites[last].normal + self.pellets.sites[self._at].normal
        over = Way(start, end, t_s, lasts_s, 0.5 * ARCH * apart_mm * normals)
        self._plan([over, Way(end, self.pellets.target_mm(self._at), t_s + lasts_s, DOWN_S)])


class PushTask(PelletTask):
    """Push each pellet DEPTH_MM under the beating surface; its deepest place counts."""

    def __init__(self, pellets: Pellets, loop: Loop) -> None:
        super().__init__(pellets, loop, HOLD_S)
        self._deepest_mm = -math.inf

    def _look(self, tip_mm: FloatArray, phase: float) -> float:
        depth_mm = float(self._heart.truth.distance(tip_mm[None], np.array([phase]))[0][0])
        beside_mm = float(np.linalg.norm(tip_mm - self.pellets.target_mm(self.done, phase)))
        if beside_mm > BESIDE_MM:
            return WAY
        self._deepest_mm = max(self._deepest_mm, depth_mm)
        if self._deepest_mm > 0.0 and depth_mm < -CLEAR_MM:
            self.done, self._deepest_mm = self.done + 1, -math.inf
            return WAY
        return WORK + self.done


class RemoveTask(PelletTask):
    """Remove each pellet: stay REMOVED_AFTER_S within REACH_MM of its centre."""

    _within = 0

    def _look(self, tip_mm: FloatArray, phase: float) -> float:
        here = self.done
        near = float(np.linalg.norm(tip_mm - self.pellets.target_mm(here, phase))) <= REACH_MM
        self._within = self._within + 1 if near else 0
        if self._within >= round(REMOVED_AFTER_S * RATE_HZ):
            self.done, self._within = here + 1, 0
        return WORK + here


def pellet_trial(
    heart: OperatingHeart,
    task: str,
    condition: Condition,
    seed: int,
    number: int = 0,
    *,
    device: SimulatedDevice = DEVICE,
    limits: DeviceLimits = LIMITS,
    fulcrum: bool = True,
) -> tuple[Loop, PelletTask]:
    """Prepare a trial of "cutting" or "dissection".

    Args:
        seed: of the operator; draws with the trial's number the pellets and the fulcrum.
        device: simulated, in the operator's hand; limits: of the device, whatever it is.
        fulcrum: dissect through one; else the tip is in the hand.
    """
    pellets = pellets_of(heart, task, seed, number)
    side = perpendicular(ACCESS, np.array([0.0, 0.0, 1.0]))
    trocar, sight, target_mm = None, -ACCESS, DEPTH_MM
    law: Law = cutting_law(limits)
    if task == "dissection":
        sight = -(math.cos(CAMERA_RAD) * ACCESS + math.sin(CAMERA_RAD) * side)
        trocar = _fulcrum(pellets, side, child_rng(seed, f"fulcrum {number}")) if fulcrum else None
        target_mm, law = -HEIGHT_MM, dissection_law(limits)
    start_mm = pellets.hover_mm(0)
    loop = Loop(heart, condition, seed, law, start_mm, sight, target_mm, trocar, device=device, limits=limits)
    return loop, (PushTask if task == "cutting" else RemoveTask)(pellets, loop)


def _fulcrum(pellets: Pellets, side: FloatArray, rng: np.random.Generator) -> Fulcrum:
    angle = 2.0 * math.pi * int(rng.integers(FULCRA)) / FULCRA
    across = math.cos(angle) * side + math.sin(angle) * np.cross(ACCESS, side)
    way_in = math.cos(TILT_RAD) * ACCESS + math.sin(TILT_RAD) * across
    return Fulcrum(pellets.target_mm(0) + INSIDE_MM * way_in, LENGTH_MM)


def cutting_law(limits: DeviceLimits = LIMITS) -> Sigmoid:
    """The steepest forbidden region that the device renders, guarding DEPTH_MM."""
    cap_n = Sigmoid().cap_n
    return Sigmoid((1.0 - 1e-9) * 4.0 * limits.allowed_stiffness_n_per_mm / cap_n, cap_n, DEPTH_MM)


def guidance_law(depth_mm: float, limits: DeviceLimits = LIMITS) -> Gaussian:
    """Guidance to a depth, of the smallest dead band that the device renders."""
    return tightest_gaussian(limits.friction_n, cap_n=Sigmoid().cap_n, depth_mm=depth_mm, device=limits)


def dissection_law(limits: DeviceLimits = LIMITS) -> Gaussian:
    """Guidance to the height of the pellets, as in the paper."""
    return guidance_law(-HEIGHT_MM, limits)


def cut(heart: OperatingHeart, condition: Condition, seed: int) -> Trace:
    """One simulated operator pushes ten pellets to DEPTH_MM."""
    loop, task = pellet_trial(heart, "cutting", condition, seed)
    return run_task(loop, task, LONGEST_S)


def dissect(heart: OperatingHeart, condition: Condition, seed: int) -> Trace:
    """One simulated operator removes ten pellets through a fulcrum."""
    loop, task = pellet_trial(heart, "dissection", condition, seed)
    return run_task(loop, task, LONGEST_S)


def pellet_depths_mm(trace: Trace) -> FloatArray:
    """(n,) largest depth of the tip while it pushed each pellet."""
    numbers = np.unique(trace.stage[trace.stage >= WORK])
    return np.array([trace.depth_mm[trace.stage == number].max() for number in numbers])


def cutting_measures(trace: Trace) -> dict[str, float]:
    """Measures of the paper's Table I, over the pellets: mean, SD about it, RMS about DEPTH_MM."""
    depth = pellet_depths_mm(trace)
    return {
        "depth_mean_mm": float(depth.mean()),
        "depth_sd_mm": float(depth.std(ddof=1)) if len(depth) > 1 else 0.0,
        "depth_rms_mm": float(np.sqrt(((depth - DEPTH_MM) ** 2).mean())),
        "largest_excess_mm": float(max(0.0, (depth - DEPTH_MM).max())),
        "perforations": float((depth > DEPTH_MM + PERFORATION_MM).sum()),
        **_course(trace),
    }


BACK_MM = 0.2
"""An excursion ends so far on this side of the limit: tremor and sensor steps do not divide it."""


def count_excursions(depth_mm: FloatArray, limit_mm: float) -> int:
    """How often the depth (n,) passes the limit; one excursion lasts until the depth is BACK_MM less."""
    beyond = np.where(depth_mm > limit_mm, 1, np.where(depth_mm < limit_mm - BACK_MM, -1, 0))
    marks = beyond[beyond != 0]
    starts = np.flatnonzero(np.diff(np.concatenate([[-1], marks])) == 2)
    return len(starts)


def dissection_measures(trace: Trace) -> dict[str, float]:
    """Measures of the paper's Tables III and IV: the time until all pellets are removed.

    An error is a touch of the organ: an excursion of the tip into it.
    """
    inside = np.maximum(trace.depth_mm, 0.0)
    return {
        "errors": float(count_excursions(trace.depth_mm, 0.0)),
        "violation_mm": float(inside.max()),
        **_course(trace),
    }


def _course(trace: Trace) -> dict[str, float]:
    return {
        "time_s": float(trace.t_s[-1] + 1.0 / RATE_HZ),
        "pellets": float(len(np.unique(trace.stage[trace.stage >= WORK]))),
        "largest_force_n": float(trace.force_n.max()),
        "withheld_s": trace.withheld_s,
    }
