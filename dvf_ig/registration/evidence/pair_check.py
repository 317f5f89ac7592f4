"""Whether the pose of a pair may be believed, where the moving image may be of somebody else.

A wrong image of the same organ also has a best pose, far above chance. Two things tell it from the right one:
parts of the fan, registered alone, pull in different directions; and the moving image mirrored, which no
patient fits, can be laid on the ultrasound nearly as well.
"""

import math
from dataclasses import replace

import numpy as np

from dvf_ig.core import FloatArray, Grid, Rigid, Stop
from dvf_ig.registration.lc2.channels import ModelChannels
from dvf_ig.registration.lc2.lc2 import Lc2
from dvf_ig.registration.lc2.optimise import ClimbOptions, climb
from dvf_ig.registration.pair_images import FanVolume
from dvf_ig.registration.rigid import Level, RegistrationResult

ALONE = ClimbOptions(steps=14, cap_mm=4.0, tolerance_mm=0.05)
DECOY_LOOK = ClimbOptions(steps=12, cap_mm=5.0, tolerance_mm=0.3)
DECOY_END = ClimbOptions(steps=12, cap_mm=2.0, tolerance_mm=0.1)
DECOY_STARTS = 6
"""Climbs for each mirrored image, displaced by DECOY_SPREAD of the fan's radius."""
DECOY_SPREAD = 0.25
DECOY_POWER = 0.2
MOST_DOUBT = 1.3
PER_DOUBT = 6.0
"""Doubt is the disagreement of parts and of interleaved halves in mm, times the decoys' share to the power of
0.2. On seeds 101–104 of two made-up brains, one of them also at half its size, all with 1 mm RMS of shift, it
is 0.4 to 1.2 for images of one brain and 1.5 to 4.3 for images of two."""


def doubt_about(
    result: RegistrationResult,
    fan: FanVolume,
    coarse: Level,
    fine: Level,
    patch_mm: float,
    rng: np.random.Generator,
) -> float:
    """How little the evidence supports a result; see `MOST_DOUBT`.

    Args:
        fan: ultrasound that `fine` was made of.
        coarse, fine: what was registered.
    """
    pose = result.mr_from_tracker
    parts = float(np.sqrt(np.mean(np.square(part_disagreement_mm(fan, fine, pose, patch_mm)))))
    share = decoy_share(fan, coarse, fine, pose, patch_mm, rng)
    return float((result.disagreement_mm + parts) * share**DECOY_POWER)


def part_disagreement_mm(fan: FanVolume, level: Level, pose: Rigid, patch_mm: float) -> FloatArray:
    """(6,) mean distance over each part between its own pose and `pose`; two halves along each axis."""
    apart = []
    for axis in range(3):
        middle = int(np.median(np.nonzero(fan.seen)[axis]))
        for part in (fan.cut(axis, 0, middle), fan.cut(axis, middle, fan.grid.shape[axis])):
            points = part.points_mm(500)
            whole = pose.apply_array(points)
            metric = Lc2(part.slices(), level.model, patch_mm=patch_mm, pitch_mm=level.pitch_mm)
            alone = climb(metric, pose, whole.mean(axis=0), None, ALONE).pose
            apart.append(float(np.linalg.norm(alone.apply_array(points) - whole, axis=1).mean()))
    return np.array(apart)


def decoy_share(
    fan: FanVolume, coarse: Level, fine: Level, pose: Rigid, patch_mm: float, rng: np.random.Generator
) -> float:
    """What the best mirrored image explains beyond chance, as a share of what the image itself does."""
    center, radius = pose.apply_array(fan.points_mm(5000).mean(axis=0)), fan.radius_mm
    chance, best = [], []
    for axis in range(3):
        looks, end = (
            Lc2(level.slices, mirrored(level.model, axis, center), patch_mm=patch_mm, pitch_mm=level.pitch_mm)
            for level in (coarse, fine)
        )
        directions = rng.normal(size=(DECOY_STARTS, 6))
        directions *= DECOY_SPREAD * radius / np.linalg.norm(directions, axis=1, keepdims=True)
        starts = [pose.perturbed_left(d[:3] / radius, d[3:], center) for d in directions]
        found = min((climb(looks, s, center, None, DECOY_LOOK) for s in starts), key=lambda c: c.cost)
        best.append(end.score(climb(end, found.pose, center, None, DECOY_END).pose).similarity)
        chance.append(end.score(pose).similarity)
    metric = Lc2(fine.slices, fine.model, patch_mm=patch_mm, pitch_mm=fine.pitch_mm)
    explained = metric.score(pose).similarity - float(np.mean(chance))
    return float(np.clip((max(best) - np.mean(chance)) / max(explained, 1e-12), 0.0, 1.0))


def mirrored(model: ModelChannels, axis: int, center_mm: FloatArray) -> ModelChannels:
    """The model reflected along a grid axis in the plane through `center_mm` (3,)."""
    grid = model.grid
    index = np.zeros(3)
    index[axis] = 2 * grid.to_index(center_mm)[axis] - (grid.shape[axis] - 1)
    there = Grid(grid.frame, grid.shape, grid.to_mm(index), grid.spacing_mm, grid.direction)
    return ModelChannels(there, np.ascontiguousarray(np.flip(model.values, axis + 1)), model.fractions)


def judged(result: RegistrationResult, doubt: float, seconds: float) -> RegistrationResult:
    """The result, not usable and unlikely where the doubt is large."""
    doubtful = 1.0 / (1.0 + math.exp(-min(max(PER_DOUBT * (doubt - MOST_DOUBT), -30.0), 30.0)))
    return replace(
        result,
        stop=Stop.DISAGREEMENT if result.stop.usable and not doubt <= MOST_DOUBT else result.stop,
        success_probability=result.success_probability * (1.0 - doubtful),
        seconds=seconds,
    )
