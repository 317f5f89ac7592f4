"""What a registered pose is tested by, and what each test may be in a registration that may guide."""

import math
from dataclasses import dataclass

import numpy as np

from dvf_ig.registration.lc2.lc2 import Lc2
from dvf_ig.registration.pose_chart import PoseChart, random_displacements

from .pair_evidence import PairEvidence
from .phase_offset import PhaseOffset

WRONG_POSES, WRONG_MM = 24, 20.0
"""How many wrong poses the z-score compares with, and how far away they lie."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What each test may be at most (the z-score: at least) in a registration that may guide.

    At a wrong local optimum the z-score is low and the boundary lies elsewhere; deformation shows as
    disagreement between half-volumes, a motion other than in the pre-operative images as disagreement between
    parts of the cycle. Attributes as in `Evidence`.
    """

    z_score: float = 3.8
    split_half_mm: float = 4.0
    phase_mm: float = math.inf
    half_volume_mm: float = math.inf
    boundary_mm: float = math.inf


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a registered pose was tested by, one value a test; None where one could not be made.

    Attributes:
        z_score: standard deviations by which LC2 stands above wrong poses WRONG_MM away.
        split_half_mm: mean distance over the heart between the optima of two interleaved halves of the
            slices.
        phase_mm: the largest such distance between one part of the cycle and the rest; None where the slices
            are of fewer phases than parts.
        half_volume_mm: RMS distance of the optima of half-volumes from that of all; None where the slices lie
            in too little of space.
        boundary_mm: mean distance over the heart between the poses of LC2 and of the boundary; None where the
            model's surface was not given, inf where the slices show no boundary.
        phase_offset: how much later in the cycle the slices fit than the ECG says; None where nothing beats.
        pair: of a pair of images of an organ that does not beat; None of a heart.
    """

    z_score: float
    split_half_mm: float
    phase_mm: float | None = None
    half_volume_mm: float | None = None
    boundary_mm: float | None = None
    phase_offset: PhaseOffset | None = None
    pair: PairEvidence | None = None

    def worst_test_ratio(self, limits: Limits) -> float:
        """The worst test as a share of its limit: above 1 the pose must not guide."""
        ratios = [limits.z_score / max(self.z_score, 1e-9)]
        for value, limit in (
            (self.split_half_mm, limits.split_half_mm),
            (self.phase_mm, limits.phase_mm),
            (self.half_volume_mm, limits.half_volume_mm),
            (self.boundary_mm, limits.boundary_mm),
        ):
            if value is not None:
                ratios.append(value / limit)
        return float(max(ratio if math.isfinite(ratio) else math.inf for ratio in ratios))


IMAGE_LIMITS = Limits()
"""For images of any organ: parts and boundary are no reason against the pose by themselves."""
SLICE_LIMITS = Limits(z_score=3.8, split_half_mm=2.5, phase_mm=3.0, half_volume_mm=2.5, boundary_mm=5.0)
"""For tracked slices of a heart: twice what 99 of 100 good poses stay below (0.84, 1.9, 1.3 and 2.5 mm in 33
sweeps below 2 mm, tuning seeds 1001 and 1002, 14 fields of mismatch), half as much again for parts of the
cycle: each alone is against the pose; what they say together is in `assessment`."""
VOLUME_LIMITS = Limits(z_score=5.5, split_half_mm=2.0, phase_mm=2.2, half_volume_mm=2.5, boundary_mm=3.0)
"""For gated 3-D images of hearts that vary. Chosen on threshold hearts 2001–2030; on 2001–2087 1 of 161 good
poses (below 2 mm, calm and poor images) stands above one of them, 5 are refused with what the checks say
together, in `assessment`, and 27 of 29 above 3 mm, disturbed trials included. Thirds of the cycle of good
poses lie up to 2.1 mm apart, so that a motion other than the model's shows from there on."""


def wrong_pose_z_score(metric: Lc2, chart: PoseChart, rng: np.random.Generator) -> float:
    """How far the similarity at a pose stands above wrong poses, in their standard deviations.

    Wrong poses are displaced by WRONG_MM at the heart's radius in random directions: what this image quality
    and these views score without being registered.
    """
    displacements = random_displacements(rng, WRONG_POSES, WRONG_MM)
    wrong = np.array([metric.score(chart.pose(xi)).similarity for xi in displacements])
    return float((metric.score(chart.base).similarity - wrong.mean()) / max(float(wrong.std()), 1e-12))
