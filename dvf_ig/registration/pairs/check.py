"""Whether the pose of a pair may be used, by consistency with itself: no limit depends on what LC2 is worth.

Every part of the ultrasound is registered again from the pose of all; parts of a pair that belongs together
agree, and the jack-knife over parts says how far off the pose may be (Efron and Tibshirani 1993, ch. 11). A
wrong pose, or the image of somebody else, is one of many that explain the ultrasound about as well.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dvf_ig.core import FloatArray, IntArray, Rigid, read_only_arrays
from dvf_ig.registration.evidence.pair_evidence import PairEvidence
from dvf_ig.registration.lc2.optimise import OptimiserOptions, optimise
from dvf_ig.registration.lc2.volume_lc2 import VolumeChannels, VolumeLc2
from dvf_ig.registration.pose_chart import PoseChart, covariance_from_mm, random_displacements

from .search import FINE, Place, SearchResult, similarity_of

PART = OptimiserOptions(steps=12, cap_mm=3.0, tolerance_mm=0.1)
"""Descents of a part of the ultrasound, from the pose of all."""
PARTS = 8
"""Octants about the median place along the ultrasound's axes: each holds about as many patches."""
LEAST_PATCHES = 12
"""A part with fewer says nothing."""
MIRRORED = OptimiserOptions(steps=12, cap_mm=5.0, tolerance_mm=0.3)
"""Descents of the ultrasound against mirrored anatomy."""
MIRRORED_STARTS, MIRRORED_MM = 4, 8.0
"""Displaced starts of that, and how far they are displaced at the fan's radius."""
WRONG_POSES, WRONG_MM = 40, 15.0
"""How many wrong poses the z-score compares with, and how far away they lie."""
FLOOR_MM = 0.2
"""Standard deviation of a pose that no image of such voxels can stay below."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PairChecks:
    """Results of the tests of a pose.

    Attributes:
        evidence: for or against the pose.
        covariance: (6, 6) rad², mm², by the jack-knife.
    """

    evidence: PairEvidence
    covariance: FloatArray


def octants(centers_mm: FloatArray, axes: FloatArray) -> IntArray:
    """(p,) which of PARTS each place (p, 3) lies in; axes (3, 3), one a column."""
    along = centers_mm @ axes
    return np.asarray(((along > np.median(along, axis=0)) * [1, 2, 4]).sum(axis=1), dtype=np.int64)


def left_out_poses(fine: VolumeLc2, part: IntArray, pose: Rigid, place: Place) -> list[Rigid]:
    """The optimum without each part that is not too small, from `pose`."""
    sizes = np.bincount(part, minlength=PARTS)
    return [
        optimise(fine.restricted(part != k), pose, place.center_mm, None, PART).pose
        for k in range(PARTS)
        if LEAST_PATCHES <= sizes[k] <= len(part) - LEAST_PATCHES
    ]


def jackknife_mm(poses: Sequence[Rigid], place: Place) -> float:
    """RMS error over the points that the spread of poses, each with one part left out, predicts."""
    if len(poses) < 2:
        return float("inf")
    places = np.array([pose.apply_array(place.points_mm) for pose in poses])
    variance = np.square(places - places.mean(axis=0)).sum(axis=(0, 2)).mean()
    return float(np.sqrt((len(poses) - 1) / len(poses) * variance))


def jackknife_covariance(poses: Sequence[Rigid], pose: Rigid, place: Place) -> FloatArray:
    """(6, 6) rad², mm²; of few parts, and hence half of it spread evenly over the directions."""
    chart = PoseChart(pose, place.center_mm)
    xi = np.array([chart.coordinates(other) for other in poses] or [np.zeros(6)])
    spread = xi - xi.mean(axis=0)
    covariance = (len(xi) - 1) / len(xi) * spread.T @ spread
    even = np.trace(covariance) / 6.0 * np.eye(6)
    return covariance_from_mm(0.5 * covariance + 0.5 * even + FLOOR_MM**2 * np.eye(6))


def interleaved_halves_mm(fine: VolumeLc2, part: IntArray, pose: Rigid, place: Place) -> float:
    """Distance between the optima of two halves, each of every second octant."""
    odd = np.array([bin(k).count("1") % 2 for k in range(PARTS)])[part]
    both = [optimise(fine.restricted(odd == half), pose, place.center_mm, None, FINE).pose for half in (0, 1)]
    return place.apart_mm(*both)


def gather_pair_evidence(
    coarse: VolumeLc2,
    fine: VolumeLc2,
    search: SearchResult,
    place: Place,
    *,
    moved_mm: float,
    rng: np.random.Generator,
    report_progress: Callable[[float], None],
) -> PairChecks:
    """Gather the evidence for the pose of a search."""
    part = octants(fine.centers_mm, fine.grid.direction)
    poses = left_out_poses(fine, part, search.pose, place)
    report_progress(0.6)
    halves_mm = interleaved_halves_mm(fine, part, search.pose, place)
    report_progress(0.8)
    wrong = wrong_pose_similarities(fine, search.pose, place, rng)
    evidence = PairEvidence(
        agreeing_starts=search.agreeing,
        similarity=search.similarity,
        chance=float(wrong.mean()),
        elsewhere=search.elsewhere,
        jackknife_mm=jackknife_mm(poses, place),
        halves_mm=halves_mm,
        z_score=float((search.similarity - wrong.mean()) / max(float(wrong.std()), 1e-12)),
        moved_mm=moved_mm,
        mirrored_share=mirrored_share(coarse, search.pose, place, rng=rng),
    )
    return PairChecks(evidence, jackknife_covariance(poses, search.pose, place))


def mirrored_share(coarse: VolumeLc2, pose: Rigid, place: Place, *, rng: np.random.Generator) -> float:
    """Explanation by the best mirrored anatomy, which fits no patient, as a share of that by the anatomy."""
    explained = similarity_of(optimise(coarse, pose, place.center_mm, None, MIRRORED))
    best = 0.0
    for axis in range(3):
        metric = coarse.against(mirrored(coarse.model, axis, place.center_mm))
        for xi in random_displacements(rng, MIRRORED_STARTS, MIRRORED_MM):
            end = optimise(metric, place.displaced(pose, xi), place.center_mm, None, MIRRORED)
            best = max(best, similarity_of(end))
    return float(np.clip(best / max(explained, 1e-12), 0.0, 1.0))


def mirrored(model: VolumeChannels, axis: int, center_mm: FloatArray) -> VolumeChannels:
    """The model reflected along a grid axis in the plane through `center_mm` (3,)."""
    grid = model.grid
    index = np.zeros(3)
    index[axis] = 2 * grid.to_index(center_mm)[axis] - (grid.shape[axis] - 1)
    return VolumeChannels(
        replace(grid, origin_mm=grid.to_mm(index)), np.ascontiguousarray(np.flip(model.values, axis))
    )


def wrong_pose_similarities(
    fine: VolumeLc2, pose: Rigid, place: Place, rng: np.random.Generator
) -> FloatArray:
    """(WRONG_POSES,) LC2 at poses WRONG_MM away, where nothing is registered."""
    displacements = random_displacements(rng, WRONG_POSES, WRONG_MM)
    return np.array([fine.score(place.displaced(pose, xi)).similarity for xi in displacements])
