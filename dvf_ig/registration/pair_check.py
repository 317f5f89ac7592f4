"""Whether the pose of a pair may be used, where one image may be of somebody else.

A wrong image of the same organ also has a best pose, far above chance. Two checks tell it from the right one:
half-volumes of the ultrasound, registered on their own, disagree; and the anatomy mirrored, which no patient
fits, can be registered to the ultrasound nearly as well.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from dvf_ig.core import FloatArray, Grid, Rigid, Stop
from dvf_ig.registration.evidence.half_volumes import HalfVolume, half_volume_disagreements_mm
from dvf_ig.registration.lc2.channels import ModelChannels
from dvf_ig.registration.lc2.optimise import OptimiserOptions, optimise
from dvf_ig.registration.lc2.threads import SliceThreads

from .data import Level, RegistrationOptions
from .pair_images import FanVolume
from .pose_chart import random_displacements
from .result import RegistrationResult

HALF_OPTIMISER = OptimiserOptions(steps=14, cap_mm=4.0, tolerance_mm=0.05)
MIRRORED_COARSE = OptimiserOptions(steps=12, cap_mm=5.0, tolerance_mm=0.3)
MIRRORED_FINE = OptimiserOptions(steps=12, cap_mm=2.0, tolerance_mm=0.1)
MIRRORED_STARTS = 6
"""Starts for each mirrored image, displaced by MIRRORED_SPREAD of the fan's radius."""
MIRRORED_SPREAD = 0.25
MIRRORED_POWER = 0.2
MAX_STATISTIC = 1.3
LOGISTIC_SLOPE = 6.0
"""The statistic is the disagreement of half-volumes and of interleaved halves in mm, times the share of the
mirrored images to the power of 0.2. On seeds 101–104 of two synthetic brains, one of them also at half its
size, all with 1 mm RMS of shift, it is 0.4 to 1.2 for images of one brain, 1.5 to 4.3 for images of two."""


def pair_statistic(
    result: RegistrationResult,
    fan: FanVolume,
    coarse: Level,
    fine: Level,
    *,
    options: RegistrationOptions,
    rng: np.random.Generator,
) -> float:
    """How little the evidence supports a result; see `MAX_STATISTIC`.

    Args:
        fan: ultrasound that `fine` was made of.
        coarse, fine: what was registered.
    """
    pose = result.target_from_source
    with SliceThreads() as threads:
        apart = half_volume_disagreements_mm(
            _halves_of(fan, pose),
            fine.model,
            pose,
            patch_mm=options.patch_mm,
            pitch_mm=fine.pitch_mm,
            optimiser=HALF_OPTIMISER,
            threads=threads,
        )
        half_volumes_mm = float(np.sqrt(np.mean(np.square(apart))))
        share = _mirrored_share(fan, coarse, fine, pose, options=options, threads=threads, rng=rng)
    return float((result.evidence.split_half_mm + half_volumes_mm) * share**MIRRORED_POWER)


def apply_pair_check(result: RegistrationResult, statistic: float) -> RegistrationResult:
    """The result, not usable and unlikely where the statistic is large."""
    exponent = -min(max(LOGISTIC_SLOPE * (statistic - MAX_STATISTIC), -30.0), 30.0)
    another_patient = 1.0 / (1.0 + math.exp(exponent))
    return replace(
        result,
        stop=Stop.DISAGREEMENT if result.stop.usable and not statistic <= MAX_STATISTIC else result.stop,
        success_probability=1.0 - another_patient,
        evidence=replace(result.evidence, pair_statistic=statistic),
    )


def _halves_of(fan: FanVolume, pose: Rigid) -> Iterator[HalfVolume]:
    """Two halves of the fan along each axis of its grid, each turning about its own middle."""
    for axis in range(3):
        middle = int(np.median(np.nonzero(fan.insonified)[axis]))
        for part in (fan.cut(axis, 0, middle), fan.cut(axis, middle, fan.grid.shape[axis])):
            points = part.points_mm(500)
            yield HalfVolume(part.slices(), points, pose.apply_array(points).mean(axis=0))


def _mirrored_share(
    fan: FanVolume,
    coarse: Level,
    fine: Level,
    pose: Rigid,
    *,
    options: RegistrationOptions,
    threads: SliceThreads,
    rng: np.random.Generator,
) -> float:
    """What the best mirrored image explains beyond chance, as a share of what the image itself does."""
    center, radius = pose.apply_array(fan.points_mm(5000).mean(axis=0)), fan.radius_mm
    chance, best = [], []
    for axis in range(3):
        at_coarse, at_fine = (
            replace(level, model=mirrored(level.model, axis, center)).metric(options, threads)
            for level in (coarse, fine)
        )
        displacements = random_displacements(rng, MIRRORED_STARTS, MIRRORED_SPREAD * radius)
        starts = [pose.perturbed_left(xi[:3] / radius, xi[3:], center) for xi in displacements]
        optima = [optimise(at_coarse, start, center, None, MIRRORED_COARSE) for start in starts]
        found = min(optima, key=lambda optimum: optimum.cost)
        refined = optimise(at_fine, found.pose, center, None, MIRRORED_FINE)
        best.append(at_fine.score(refined.pose).similarity)
        chance.append(at_fine.score(pose).similarity)
    explained = fine.metric(options, threads).score(pose).similarity - float(np.mean(chance))
    return float(np.clip((max(best) - np.mean(chance)) / max(explained, 1e-12), 0.0, 1.0))


def mirrored(model: ModelChannels, axis: int, center_mm: FloatArray) -> ModelChannels:
    """The model reflected along a grid axis in the plane through `center_mm` (3,)."""
    grid = model.grid
    index = np.zeros(3)
    index[axis] = 2 * grid.to_index(center_mm)[axis] - (grid.shape[axis] - 1)
    there = Grid(grid.frame, grid.shape, grid.to_mm(index), grid.spacing_mm, grid.direction)
    return ModelChannels(there, np.ascontiguousarray(np.flip(model.values, axis + 1)), model.fractions)
