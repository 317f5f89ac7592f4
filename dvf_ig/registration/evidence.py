"""Whether a registration may be believed: what it is measured by, and the success probability from that."""

import math
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray

from .chart import PoseChart, distance_between
from .curvature import Curvature
from .edge_fit import EdgeFit
from .similarity import Lc2

WRONG_POSES = 24
WRONG_MM = 20.0
PHASE_GROUPS = 3


@dataclass(frozen=True, slots=True)
class Evidence:
    """Attributes:
    contrast: standard deviations by which LC2 stands above wrong poses WRONG_MM away.
    halves_mm: mean distance over the heart between what two halves of the slices would have.
    phases_mm: the largest such distance between one part of the cycle and the rest.
    similarity: LC2, the share of the ultrasound's local variance that the model explains.
    edges_mm: mean distance over the heart between the poses of LC2 and of the borders; None without those.
    edges_near: share of the borders that lie on the model's surface there.
    """

    contrast: float
    halves_mm: float
    phases_mm: float
    similarity: float
    edges_mm: float | None = None
    edges_near: float | None = None


def contrast_of(metric: Lc2, chart: PoseChart, rng: np.random.Generator) -> float:
    """How far the similarity at a pose stands above wrong poses, in their standard deviations.

    Wrong poses are displaced by WRONG_MM at the heart's radius in random directions: the height at which this
    image quality and these views score without being registered.
    """
    directions = rng.normal(size=(WRONG_POSES, 6))
    directions *= WRONG_MM / np.linalg.norm(directions, axis=1, keepdims=True)
    wrong = np.array([metric.score(chart.pose(xi)).similarity for xi in directions])
    return float((metric.score(chart.base).similarity - wrong.mean()) / max(float(wrong.std()), 1e-12))


def halves_of(count: int) -> tuple[BoolArray, BoolArray]:
    """(s,) twice: every second slice, and the rest."""
    even = np.arange(count) % 2 == 0
    return even, ~even


def phase_groups(model_phase: FloatArray) -> tuple[BoolArray, ...]:
    """(s,) masks of parts of the cycle with about equally many slices; none where all are of one phase."""
    order = np.unique(model_phase)
    if len(order) < PHASE_GROUPS:
        return ()
    rank = np.searchsorted(np.sort(model_phase), model_phase, side="left")
    group = rank * PHASE_GROUPS // len(model_phase)
    return tuple(group == g for g in range(PHASE_GROUPS) if (group == g).any())


def evidence_of(
    curvature: Curvature,
    model_phase: FloatArray,
    contrast: float,
    similarity: float,
    borders: EdgeFit | None = None,
) -> Evidence:
    """Evidence of the pose about which `curvature` was taken."""
    chart = curvature.chart
    halves = halves_of(len(model_phase))
    groups = phase_groups(model_phase)
    return Evidence(
        contrast=contrast,
        halves_mm=curvature.disagreement_mm(*halves),
        phases_mm=max((curvature.disagreement_mm(g, ~g) for g in groups), default=0.0),
        similarity=similarity,
        edges_mm=None if borders is None else distance_between(chart.base, borders.pose, chart.center_mm),
        edges_near=None if borders is None else borders.share_near,
    )


LOGISTIC = (-8.0, 2.0, -2.0)


def success_probability(evidence: Evidence) -> float:
    """Chance that the mean error over the heart is below 2 mm, from the evidence of one registration."""
    bias, by_contrast, by_mm = LOGISTIC
    score = bias + by_contrast * min(evidence.contrast, 10.0) + by_mm * min(evidence.halves_mm, 1e3)
    return 1.0 / (1.0 + math.exp(-min(max(score, -30.0), 30.0)))
