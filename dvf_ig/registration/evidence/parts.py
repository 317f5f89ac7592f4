"""Parts of the slices registered on their own: where no one rigid pose fits them all, their poses disagree.

    interleaved halves   every second slice against the rest: noise of tracker and speckle
    parts of the cycle   thirds of the slices by phase: a motion, or a gate, other than the model's
    half-volumes         either side of the centre along each axis: deformation

Each part is optimised from the pose of all, under a wide Gaussian prior about it: in a direction of which a
part says nothing it stays with the whole, where a step by gradient over curvature would take it anywhere.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, Rigid, mean_displacement_mm
from dvf_ig.registration.gaussian_prior import GaussianPrior
from dvf_ig.registration.lc2.lc2 import Lc2
from dvf_ig.registration.lc2.optimise import OptimiserOptions, optimise
from dvf_ig.registration.lc2.slices import SliceSet
from dvf_ig.registration.pose_chart import PoseChart

from .half_volumes import half_spaces

PHASE_GROUPS = 3
"""Parts of the cycle, each of which is registered by itself."""
PART_OPTIMISER = OptimiserOptions(steps=7, cap_mm=4.0, tolerance_mm=0.15)
"""Of a part of the slices, from the pose of all:"""

MetricOf = Callable[[SliceSet], Lc2]


@dataclass(frozen=True, slots=True)
class PartDisagreements:
    """How far apart the poses of parts of the slices lie, mean over the heart; None where there are no parts.

    Where nothing of the slices is left to compare, their halves are inf apart.

    Attributes:
        split_half_mm: of two interleaved halves.
        phase_mm: the largest of one part of the cycle and the rest.
        half_volume_mm: RMS over half-volumes of the distance there from the pose of all.
    """

    split_half_mm: float
    phase_mm: float | None
    half_volume_mm: float | None


def part_disagreements(
    slices: SliceSet, metric_of: MetricOf, pose: Rigid, center_mm: FloatArray
) -> PartDisagreements:
    """Register every part of the slices on its own, and compare.

    Args:
        slices: coarse ones do.
        metric_of: LC2 of some of the slices.
        pose: near the optimum of all.
        center_mm: (3,) about which poses turn, and where space is cut, target frame.
    """
    if not slices.masks.any():
        return PartDisagreements(float("inf"), None, None)
    whole = optimise(metric_of(slices), pose, center_mm, None, PART_OPTIMISER).pose
    prior = GaussianPrior(PoseChart(whole, center_mm))

    def optimum(part: SliceSet) -> Rigid:
        if not part.masks.any():
            return whole
        return optimise(metric_of(part), whole, center_mm, prior, PART_OPTIMISER).pose

    even, odd = (optimum(slices.subset(np.arange(first, len(slices), 2))) for first in (0, 1))
    apart = []
    for group in phase_groups(slices.model_phase):
        own = optimum(slices.subset(np.flatnonzero(group)))
        # the whole lies between part and rest, by their shares
        rest_share = 1.0 - float(group.mean())
        apart.append(mean_displacement_mm(own, whole, center_mm) / rest_share)
    beside = []
    for half in half_spaces(slices, whole, center_mm):
        own = optimum(half.slices)
        moved = own.apply_array(half.points_mm) - whole.apply_array(half.points_mm)
        beside.append(float(np.linalg.norm(moved, axis=1).mean()))
    return PartDisagreements(
        split_half_mm=mean_displacement_mm(even, odd, center_mm),
        phase_mm=max(apart, default=None),
        half_volume_mm=float(np.sqrt(np.mean(np.square(beside)))) if beside else None,
    )


def phase_groups(model_phase: FloatArray) -> tuple[BoolArray, ...]:
    """(s,) masks of parts of the cycle with about equally many slices; none where there are fewer phases."""
    if len(np.unique(model_phase)) < PHASE_GROUPS:
        return ()
    rank = np.searchsorted(np.sort(model_phase), model_phase, side="left")
    group = rank * PHASE_GROUPS // len(model_phase)
    return tuple(group == g for g in range(PHASE_GROUPS) if (group == g).any())
