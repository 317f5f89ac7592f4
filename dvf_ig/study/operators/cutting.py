"""Depth-controlled cutting: along a line of the epicardium, so deep and no deeper (Ren 2008, Table I)."""

from functools import cache

import numpy as np

from data_synth.operator.contact_sites import Site, contact_sites
from data_synth.operator.hand import minimum_jerk
from data_synth.operator.simulated_operator import RATE_HZ, SimulatedOperator
from data_synth.seeds import child_rng
from dvf_ig.core import FloatArray
from dvf_ig.guidance import Sigmoid

from .closed_loop import LIMITS, Aim, Loop, Trace, operator_of, run_task
from .conditions import Condition
from .excursions import count_excursions
from .heart import ACCESS, OperatingHeart
from .moving_line import MovingLine, moving_line

DEPTH_MM = 5.0
"""Of the forbidden surface under the epicardium, and of the cut that is asked for."""
PERFORATION_MM = 1.0
"""An excursion so far beyond the forbidden surface counts as a perforation: assumed."""
LENGTH_MM = 40.0
SPEED_MM_S = 4.0
SLOWING_MM = 2.0
"""The operator moves at half speed where tip and aim are so far apart by what is seen and felt."""
ABOVE_MM = 8.0
"""The tip starts so far above the surface."""
APPROACH_S = 3.0
SETTLE_S = 1.0
"""Between the end of the approach and the beginning of the cut."""
LONGEST_S = 60.0
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
        speed = SPEED_MM_S / (1.0 + (operator.believed_error_mm / SLOWING_MM) ** 2)
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
    return run_task(loop, CuttingTask(line, above, loop), LONGEST_S)


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
    return moving_line(heart.truth, cutting_site(heart, seed), LENGTH_MM, DEPTH_MM)


def cutting_measures(trace: Trace) -> dict[str, float]:
    """What the paper's Table I is about, while cutting.

    Depth error is the mean of |depth − 5 mm|; excess the largest depth beyond 5 mm.
    """
    cutting = trace.stage == CUT
    depth = trace.depth_mm[cutting]
    return {
        "depth_error_mm": float(np.abs(depth - DEPTH_MM).mean()),
        "depth_bias_mm": float((depth - DEPTH_MM).mean()),
        "largest_excess_mm": float(max(0.0, (depth - DEPTH_MM).max())),
        "perforations": float(count_excursions(depth, DEPTH_MM + PERFORATION_MM)),
        "time_s": float(cutting.sum() / RATE_HZ),
        "largest_force_n": float(trace.force_n.max()),
        "withheld_s": trace.withheld_s,
    }
