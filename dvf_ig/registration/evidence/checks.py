"""Whether a registration may be believed: what it is measured by, and the success probability from that."""

import math
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray
from dvf_ig.registration.lc2.curvature import Curvature
from dvf_ig.registration.lc2.lc2 import Lc2
from dvf_ig.registration.pose_chart import PoseChart

WRONG_POSES = 24
WRONG_MM = 20.0
PHASE_GROUPS = 3


@dataclass(frozen=True, slots=True)
class Evidence:
    """Attributes:
    contrast: standard deviations by which LC2 stands above wrong poses WRONG_MM away.
    halves_mm: mean distance over the heart between what two interleaved halves of the slices would have.
    phases_mm: the largest such distance between one part of the cycle and the rest.
    parts_mm: the same for halves of space, RMS (`parts`); None where it was not asked.
    edges_mm: mean distance over the heart between the poses of LC2 and of the borders; None without those.
    """

    contrast: float
    halves_mm: float
    phases_mm: float
    parts_mm: float | None = None
    edges_mm: float | None = None


@dataclass(frozen=True, slots=True)
class Limits:
    """What each check may be at most (contrast: at least) in a registration that may guide.

    A pose in a wrong basin has little contrast and its borders lie elsewhere; a deformed heart is torn apart
    by halves of space; one that moves otherwise than before, by parts of the cycle.
    """

    contrast: float = 3.8
    halves_mm: float = 4.0
    phases_mm: float = math.inf
    parts_mm: float = math.inf
    edges_mm: float = math.inf


TRACKED_LIMITS = Limits()
"""For tracked planes."""
VOLUME_LIMITS = Limits(contrast=5.5, halves_mm=2.0, phases_mm=1.22, parts_mm=2.25, edges_mm=2.4)
"""For gated 3-D images. On tuning seeds 101–106 good poses (below 2 mm, calm and poor images) stand against
wrong basins (contrast above 6.9, below 4.5; borders up to 2.1 mm, above 7), changed motion (phases up to
1.1 mm, above 1.4), and 5 mm of deformation (parts up to 2.2 mm, above 2.3 where the error exceeds 3 mm)."""
STEEPNESS = 10.0
"""Of the logistic in doubt: tuning seeds have 0.3 to 1.0 below 2 mm of error, and above 1 beyond 3 mm."""


def doubt_of(evidence: Evidence, limits: Limits) -> float:
    """The weakest check as a share of its limit: above 1 the pose must not guide."""
    checks = [
        limits.contrast / max(evidence.contrast, 1e-9),
        evidence.halves_mm / limits.halves_mm,
        evidence.phases_mm / limits.phases_mm,
    ]
    for value, limit in ((evidence.parts_mm, limits.parts_mm), (evidence.edges_mm, limits.edges_mm)):
        if value is not None:
            checks.append(value / limit)
    return float(max(check if math.isfinite(check) else math.inf for check in checks))


def success_probability(doubt: float) -> float:
    """Chance that the mean error over the heart is below 2 mm, from `doubt_of` one registration."""
    return 1.0 / (1.0 + math.exp(min(max(STEEPNESS * (doubt - 1.0), -30.0), 30.0)))


def contrast_of(metric: Lc2, chart: PoseChart, rng: np.random.Generator) -> float:
    """How far the similarity at a pose stands above wrong poses, in their standard deviations.

    Wrong poses are displaced by WRONG_MM at the heart's radius in random directions: the height at which this
    image quality and these views score without being registered.
    """
    directions = rng.normal(size=(WRONG_POSES, 6))
    directions *= WRONG_MM / np.linalg.norm(directions, axis=1, keepdims=True)
    wrong = np.array([metric.score(chart.pose(xi)).similarity for xi in directions])
    return float((metric.score(chart.base).similarity - wrong.mean()) / max(float(wrong.std()), 1e-12))


def halves_mm(curvature: Curvature) -> float:
    """Disagreement of every second slice with the rest."""
    even = np.arange(len(curvature.misfit)) % 2 == 0
    return curvature.disagreement_mm(even, ~even)


def phases_mm(curvature: Curvature, model_phase: FloatArray) -> float:
    """The largest disagreement of one part of the cycle with the rest; 0 where there is one phase only."""
    groups = phase_groups(model_phase)
    return max((curvature.disagreement_mm(group, ~group) for group in groups), default=0.0)


def phase_groups(model_phase: FloatArray) -> tuple[BoolArray, ...]:
    """(s,) masks of parts of the cycle with about equally many slices; none where there are fewer phases."""
    if len(np.unique(model_phase)) < PHASE_GROUPS:
        return ()
    rank = np.searchsorted(np.sort(model_phase), model_phase, side="left")
    group = rank * PHASE_GROUPS // len(model_phase)
    return tuple(group == g for g in range(PHASE_GROUPS) if (group == g).any())
