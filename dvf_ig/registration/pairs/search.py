"""Search for the pose of a pair of 3-D images: many displaced starts, the best distinct ends refined.

Where the starts end is kept: how many of them agree, and how well LC2 does at the other ends, is evidence for
the pose (see `check`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, Rigid, read_only_arrays
from dvf_ig.registration.evidence.pair_evidence import START_SIGMA_MM
from dvf_ig.registration.lc2.optimise import OptimiserOptions, Optimum, optimise
from dvf_ig.registration.lc2.volume_lc2 import VolumeLc2
from dvf_ig.registration.pose_chart import random_displacements

STARTS_MM = (0.0, 0.0, *(5.0, 5.0, 9.0, 9.0, 13.0, 13.0) * 5)
"""How far each start is displaced, at the fan's radius; the coarse levels take turns. Lengths chosen on
tuning pairs 1001–1012."""
SAME_BASIN_MM = 3.0
"""Coarse ends nearer than this, mean over the fan, are one."""
ELSEWHERE_MM = 4.0
"""An end farther than this from the best is another pose."""
REACH_MM = 20.0
"""How far a pose may move from the start."""
REFINED = 6
"""Distinct coarse ends that are optimised on the fine level."""
COARSE = OptimiserOptions(steps=18, cap_mm=5.0, tolerance_mm=0.25)
"""Descents from each start, on a coarse level."""
FINE = OptimiserOptions(steps=16, cap_mm=2.0, tolerance_mm=0.05)
"""Descents from the distinct coarse ends."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where poses are compared.

    Attributes:
        points_mm: (k, 3) insonified places, source frame.
        center_mm: (3,) about which poses turn, target frame.
        radius_mm: RMS distance of the points from their middle.
    """

    points_mm: FloatArray
    center_mm: FloatArray
    radius_mm: float

    def apart_mm(self, pose: Rigid, other: Rigid) -> float:
        """Mean distance between two poses over the points."""
        difference = pose.apply_array(self.points_mm) - other.apply_array(self.points_mm)
        return float(np.linalg.norm(difference, axis=1).mean())

    def displaced(self, pose: Rigid, xi_mm: FloatArray) -> Rigid:
        """A pose turned and moved by (6,) mm at the radius."""
        return pose.perturbed_left(xi_mm[:3] / self.radius_mm, xi_mm[3:], self.center_mm)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """Result of the search.

    Attributes:
        pose: the best.
        similarity: LC2 of it on the fine level.
        agreeing: share of the starts that ended in its basin.
        elsewhere: (k,) LC2 at the refined ends that lie elsewhere, best first.
        evaluations: of LC2.
    """

    pose: Rigid
    similarity: float
    agreeing: float
    elsewhere: FloatArray
    evaluations: int


def place_of(points_mm: FloatArray, start: Rigid) -> Place:
    """Where poses near `start` are compared, from (k, 3) insonified places."""
    middle = points_mm.mean(axis=0)
    radius_mm = float(np.sqrt(np.square(points_mm - middle).sum(axis=1).mean()))
    return Place(points_mm, start.apply_array(middle), max(radius_mm, 1.0))


def search(
    coarse: Sequence[VolumeLc2],
    fine: VolumeLc2,
    start: Rigid,
    place: Place,
    *,
    rng: np.random.Generator,
    report_progress: Callable[[float], None],
) -> SearchResult:
    """The best pose from `start` and displaced copies of it, which the coarse levels take in turn."""
    ends: list[Rigid] = []
    evaluations = 0
    for k, length_mm in enumerate(STARTS_MM):
        displaced = place.displaced(start, random_displacements(rng, 1, length_mm)[0])
        end = optimise(coarse[k % len(coarse)], displaced, place.center_mm, None, COARSE)
        ends.append(end.pose)
        evaluations += end.evaluations + 1
        report_progress(0.7 * (k + 1) / len(STARTS_MM))

    def posterior(pose: Rigid, similarity: float) -> float:
        away = place.apart_mm(pose, start) / START_SIGMA_MM
        return 0.5 * math.log1p(-similarity) + 0.5 * away**2 / coarse[0].information

    ends.sort(key=lambda pose: posterior(pose, fine.score(pose).similarity))
    basins = _basins(ends, place)
    refined = [optimise(fine, ends[members[0]], place.center_mm, None, FINE) for members in basins[:REFINED]]
    order = sorted(range(len(refined)), key=lambda k: posterior(refined[k].pose, similarity_of(refined[k])))
    best = refined[order[0]]
    # several coarse basins may run together on the fine level
    agreeing = sum(
        len(basins[k]) for k in order if place.apart_mm(refined[k].pose, best.pose) < SAME_BASIN_MM
    )
    elsewhere = [
        similarity_of(refined[k]) for k in order if place.apart_mm(refined[k].pose, best.pose) > ELSEWHERE_MM
    ]
    report_progress(1.0)
    return SearchResult(
        best.pose,
        similarity_of(best),
        agreeing / len(ends),
        np.array(sorted(elsewhere, reverse=True)),
        evaluations + sum(end.evaluations for end in refined),
    )


def similarity_of(optimum: Optimum) -> float:
    """LC2 where an optimisation ended."""
    return float(1.0 - np.exp(2.0 * optimum.cost))


def _basins(poses: list[Rigid], place: Place) -> list[list[int]]:
    """Numbers of the poses that lie near the best of their basin, basins in order of their best."""
    basins: list[list[int]] = []
    for k, pose in enumerate(poses):
        for members in basins:
            if place.apart_mm(pose, poses[members[0]]) < SAME_BASIN_MM:
                members.append(k)
                break
        else:
            basins.append([k])
    return basins
