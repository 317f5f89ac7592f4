"""Refinement of candidates on fine slices: each to its optimum, the best once more within the model alone."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from dvf_ig.registration.lc2.lc2 import Lc2
from dvf_ig.registration.lc2.optimise import OptimiserOptions, Optimum, optimise
from dvf_ig.registration.lc2.slices import within
from dvf_ig.registration.lc2.threads import SliceThreads

from .candidates import Candidates
from .data import RegistrationData, RegistrationOptions

FINE = OptimiserOptions(steps=30, cap_mm=2.0, tolerance_mm=0.01)
"""Of the candidates on fine slices:"""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """Refined candidates, and the metrics that they were refined by.

    Attributes:
        whole: LC2 on all fine slices.
        optima: of the candidates by `whole`, best first.
        inside: LC2 on what of the fine slices lies within the model's volume at the best optimum.
        best: optimum by `inside`.
    """

    whole: Lc2
    optima: tuple[Optimum, ...]
    inside: Lc2
    best: Optimum

    @property
    def evaluations(self) -> int:
        return sum(optimum.evaluations for optimum in (*self.optima, self.best))


def refine(
    data: RegistrationData,
    candidates: Candidates,
    *,
    options: RegistrationOptions,
    threads: SliceThreads,
    report_progress: Callable[[float], None],
) -> Refined:
    """Optimise every candidate on fine slices, and rank them by their cost there."""
    whole = data.fine.metric(options, threads)
    optima: list[Optimum] = []
    for k, pose in enumerate(candidates.poses):
        optima.append(optimise(whole, pose, data.center_mm, data.prior, FINE))
        report_progress((k + 1) / len(candidates.poses))
    optima.sort(key=lambda optimum: optimum.cost)
    covered = within(data.fine.slices, data.fine.model.grid, optima[0].pose)
    inside = replace(data.fine, slices=covered).metric(options, threads)
    best = optimise(inside, optima[0].pose, data.center_mm, data.prior, FINE)
    return Refined(whole, tuple(optima), inside, best)
