"""Pose and change of shape as one estimate: where it puts the walls, and how later images correct it.

The state of `ShapePosterior` is Gaussian; from beat to beat

    predict   ξ walks at random by PROCESS_NOISE_MM; z ← a z, with as much noise as keeps the variance s² of
              its prior: the heart changes its shape far more slowly than it moves
    correct   by the boundary of the beat, whose shared error w is integrated out again
A registration begins it. A later one is made of frames that the beats have used: both count half, which is
right whatever their errors share (covariance intersection: Julier and Uhlmann 1997).
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from dvf_ig.core import FloatArray, Rigid, Warp, read_only_arrays
from dvf_ig.core.space.warp import CELLS, knots
from dvf_ig.kernels.warp import LARGEST_MM2
from dvf_ig.registration.boundary.fit import Boundary
from dvf_ig.registration.boundary.points import BoundaryPoints
from dvf_ig.registration.boundary.target import BoundaryTarget
from dvf_ig.registration.pose_chart import PoseChart, rigid_motion

from .modes import ShapeModes, shape_modes
from .posterior import (
    FIXED,
    OFFSET_SIGMA_MM,
    THIN_SIGMA_MM,
    Level,
    SeenBoundary,
    ShapePosterior,
    ShapeProblem,
)

MODES = 200
"""Modes of a change of shape. With points exactly on the boundary of a heart 5 mm different, 100 leave 1.1 mm
where the wall is seen, 200 and 400 leave 0.8; 30 leave 2.1 mm even if every point is matched to itself."""
SIGMA_FACTOR, SIGMA_FLOOR_MM, SIGMA_SHARE = 1.15, 0.3, 0.13
"""Standard deviations of prior and noise count SIGMA_FACTOR times; to them are added SIGMA_FLOOR_MM and
SIGMA_SHARE of the scale, which no point near by removes. From 24 changes of threshold hearts 2132 to 2140,
1.2 to 7 mm: errors are 0.9 to 1.0 of the sum where the wall is seen, 0.7 to 1.1 where it is not."""
SCALE_SPREAD = 0.05
"""Half the variance of a heart's mean square error as a share of its square, beyond what covariances between
walls make it: of the same hearts it is 0.44 to 1.6 of the mean variance that is stated."""
MARGIN_MM = 30.0
"""How far the pull-back is given beyond the walls."""
WALL_MM = (-12.0, 2.0)
"""Distances from the boundary of blood between which the walls lie, positive in the blood."""
WALL_PLACES = 700
PROCESS_NOISE_MM = 0.15
"""Standard deviation per coordinate of the heart's displacement from beat to beat."""
FORGOTTEN = 5e-4
"""Share of a change of shape that is forgotten from beat to beat. In threshold sessions 2111 to 2114, 0 and
this leave the same at the tool; 0.02 half as much again in hearts 5 mm different."""
BEAT_POINTS, LEAST_BEAT_POINTS = 150, 30
"""Most points of one beat that count, and the fewest that say something. Beats after beats share more of the
boundary's error than w holds: with 500 points errors of the walls of threshold sessions 2113 and 2114 are
1.08 and 1.09 of their standard deviations, with 150 they are 0.89 and 0.97, and no larger."""
INSIDE = 1e-6
"""How far within the box of a spline places are that are moved into it, in knots."""
LARGEST_SLOPE = 0.5
"""Largest ‖Dm‖: 0.43 in threshold hearts 5 mm different, where the wall is right; folds begin at 1."""


class Contraction(NamedTuple):
    """How many times as far as in the model the heart contracts, and the standard deviation of that."""

    factor: float
    sigma: float


AS_IN_MODEL = Contraction(1.0, 0.0)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class GuardedWalls:
    """How well the walls are known at which a force may be given.

    Attributes:
        square_of_motion: (6, 6) M: ξ of `PoseChart` moves them along their normals by ξᵀMξ in mean square.
        variance_mm2: mean variance of their place along their normals, the registered pose's included.
        square_mm4: half the variance of their mean square error over hearts, by the covariances between them
            and by how hearts differ.
    """

    square_of_motion: FloatArray
    variance_mm2: float
    square_mm4: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Places with what a state moves them by.

    Attributes:
        moved: (n, 3, MODES) by the modes; motion: (n, 3, 6) by ξ.
        columns: (n, 6 + MODES) of q − m(q) along normals, by ξ and z.
        left_out: (n,) variance along the normals of what MODES leave out, at unit scale.
    """

    moved: FloatArray
    motion: FloatArray
    columns: FloatArray
    left_out: FloatArray

    @classmethod
    def at(cls, modes: ShapeModes, places_mm: FloatArray, normals: FloatArray) -> "Places":
        """Evaluate modes and rigid motion at (n, 3) places with (n, 3) normals."""
        moved, motion = modes.at(places_mm, MODES), rigid_motion(places_mm, modes.center_mm)
        along = np.einsum("ni,nik->nk", normals, moved)
        left_out = modes.variance_along(places_mm, normals) - (along**2).sum(axis=1)
        columns = np.concatenate([np.einsum("ni,nip->np", normals, motion), -along], axis=1)
        return cls(moved, motion, columns, np.maximum(left_out, 0.0))

    def pulled_mm(self, best: ShapePosterior) -> FloatArray:
        """(n, 3) pull-back m."""
        return np.asarray(self.moved @ best.state[FIXED:] - self.motion @ best.state[:6])

    def covariance_along(self, best: ShapePosterior) -> tuple[FloatArray, FloatArray]:
        """(n, k) F and (n,) v: the errors of q − m(q) along normals have the covariance F Fᵀ + diag(v)."""
        kept = np.r_[:6, FIXED : len(best.state)]  # all but the offsets
        root = np.linalg.cholesky(best.covariance_mm2[np.ix_(kept, kept)])
        alone = SIGMA_FACTOR**2 * best.scale_mm**2 * self.left_out
        floor = SIGMA_FLOOR_MM**2 + (SIGMA_SHARE * best.scale_mm) ** 2
        return SIGMA_FACTOR * self.columns @ root, alone + floor

    def variance_mm2(self, best: ShapePosterior) -> FloatArray:
        """(n,) variance of q − m(q) along the normals."""
        columns, alone = self.covariance_along(best)
        return np.asarray((columns**2).sum(axis=1) + alone)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ShapeEstimate:
    """A change of shape at one pose, and how well it is known; made by `estimate_of`.

    Attributes:
        posterior: the state at the pose.
        noise: factor on the errors of the boundary.
        level: about which o and τ are counted.
        target: boundary of blood in the model; organ: its outer surface, see `SeenBoundary`.
        center_mm: (3,) about which poses turn, target frame.
        contraction: at which the state explains the boundary; it stays as the registration found it.
        warp: the pull-back m, with the variance of the wall's place along its normal, the pose's included.
        walls: how well it knows those that are guarded.
    """

    posterior: ShapePosterior
    noise: float
    level: Level
    target: BoundaryTarget
    organ: BoundaryTarget | None
    center_mm: FloatArray
    contraction: Contraction
    warp: Warp
    walls: GuardedWalls

    def predicted(self, beats: float) -> "ShapeEstimate":
        """Age the state by some beats; warp and walls stay those of the last correction."""
        kept = np.ones(len(self.posterior.state))
        kept[FIXED:] = (1.0 - FORGOTTEN) ** beats
        added = self.posterior.scale_mm**2 * (1.0 - kept**2)
        added[:6] = beats * PROCESS_NOISE_MM**2
        covariance = kept[:, None] * self.posterior.covariance_mm2 * kept + np.diag(added)
        state = kept * self.posterior.state
        return replace(self, posterior=replace(self.posterior, state=state, covariance_mm2=covariance))

    def corrected(self, points: BoundaryPoints, pose: Rigid) -> "ShapeEstimate":
        """Correct the estimate by the boundary that one beat shows; the same where that says nothing.

        A change that becomes too abrupt for the model to follow is not taken.

        Args:
            pose: target_from_source, of the estimate.
        """
        target = contracting(self.target, self.contraction.factor)
        boundary = Boundary(points.subsampled(BEAT_POINTS), target)
        seen = SeenBoundary(boundary, self.level.offset_mm, pose, self.organ)
        modes = modes_of(self.target, tuple(self.center_mm.tolist()))
        problem = ShapeProblem(seen, modes, MODES, self.posterior, self.level)
        if len(problem) < LEAST_BEAT_POINTS:
            return self
        corrected = self.of(problem.corrected(self.posterior, self.noise))
        return self if corrected.warp.steepest > LARGEST_SLOPE else corrected

    def at_pose(self, registered: Rigid, pose: Rigid) -> "ShapeEstimate":
        """Return the same change of shape, walls where they were, stated at another pose."""
        moved = PoseChart(pose, self.center_mm).coordinates(registered)
        state = self.posterior.state.copy()
        state[:6] += moved
        posterior = replace(self.posterior, state=state)
        return replace(self, posterior=posterior, warp=self.warp.at_pose(registered, pose))

    def intersected_with(self, registered: "ShapeEstimate") -> "ShapeEstimate":
        """Fuse with a registration of frames that the beats have used, at the same pose.

        Offsets of the boundary become those of the registration.
        """
        kept = np.r_[:6, FIXED : len(self.posterior.state)]
        both = [self.posterior, registered.posterior]
        inverses = [np.linalg.inv(one.covariance_mm2[np.ix_(kept, kept)]) for one in both]
        covariance = np.linalg.inv(0.5 * (inverses[0] + inverses[1]))
        right = 0.5 * sum(inverse @ one.state[kept] for inverse, one in zip(inverses, both, strict=True))
        state, whole = registered.posterior.state.copy(), np.zeros_like(registered.posterior.covariance_mm2)
        state[kept] = covariance @ right
        whole[np.ix_(kept, kept)] = 0.5 * (covariance + covariance.T)
        whole[6, 6], whole[7, 7] = OFFSET_SIGMA_MM**2, THIN_SIGMA_MM**2
        return registered.of(replace(registered.posterior, state=state, covariance_mm2=whole))

    def of(self, posterior: ShapePosterior) -> "ShapeEstimate":
        """Return another state of the same heart at the same pose."""
        of_heart = self.target, self.organ, self.center_mm
        return estimate_of(posterior, self.noise, self.level, *of_heart, self.contraction)


def estimate_of(
    posterior: ShapePosterior,
    noise: float,
    level: Level,
    target: BoundaryTarget,
    organ: BoundaryTarget | None,
    center_mm: FloatArray,
    contraction: Contraction = AS_IN_MODEL,
) -> ShapeEstimate:
    """Evaluate a state on the knots of a warp, and at the walls."""
    center = tuple(center_mm.tolist())
    warp = _warp(posterior, target, center, contraction)
    walls = _guarded_walls(posterior, target, center, contraction)
    return ShapeEstimate(posterior, noise, level, target, organ, center_mm, contraction, warp, walls)


@lru_cache(maxsize=2)
def contracting(target: BoundaryTarget, factor: float) -> BoundaryTarget:
    """The boundary of a heart that contracts so many times as far, which beats after beats take."""
    return target if factor == 1.0 else target.contracting(factor)


def _warp(
    posterior: ShapePosterior,
    target: BoundaryTarget,
    center_mm: tuple[float, ...],
    contraction: Contraction,
) -> Warp:
    """Evaluate a state on the knots of a heart's warps."""
    places, (origin_mm, knot_mm) = _at_knots(target, center_mm), _knots_of(target, center_mm)
    pulled, variance = places.pulled_mm(posterior), places.variance_mm2(posterior)
    if contraction.sigma > 0.0:
        variance = variance + (contraction.sigma * _beaten_at_knots_mm(target, center_mm)) ** 2
    return Warp.through(target.frame, origin_mm, knot_mm, pulled, variance, contraction.factor)


def _guarded_walls(
    posterior: ShapePosterior,
    target: BoundaryTarget,
    center_mm: tuple[float, ...],
    contraction: Contraction,
) -> GuardedWalls:
    """Evaluate a state at walls whose place is certain enough for a force, or at all if none is."""
    places = _at_walls(target, center_mm)
    columns, alone = places.covariance_along(posterior)
    if contraction.sigma > 0.0:
        alone = alone + (contraction.sigma * _beaten_mm(target, _walls_mm(target))) ** 2
    variance = (columns**2).sum(axis=1) + alone
    served = variance <= LARGEST_MM2
    if not served.any():
        served[:] = True
    columns, mean = columns[served], float(variance[served].mean())
    motion = places.columns[served, :6]
    # what the fit leaves out is taken to have the correlation of what it states
    alike = float(((columns.T @ columns) ** 2).sum() / (columns**2).sum() ** 2)
    return GuardedWalls(motion.T @ motion / len(motion), mean, mean**2 * (alike + SCALE_SPREAD))


# ------------------------------------------------------------------ what all estimates of a heart share


@lru_cache(maxsize=2)
def modes_of(target: BoundaryTarget, center_mm: tuple[float, ...]) -> ShapeModes:
    """Modes over the walls of a heart, which all its registrations share."""
    return shape_modes(_walls_mm(target), np.array(center_mm))


@lru_cache(maxsize=2)
def _at_knots(target: BoundaryTarget, center_mm: tuple[float, ...]) -> Places:
    modes, (origin_mm, knot_mm) = modes_of(target, center_mm), _knots_of(target, center_mm)
    places = knots(origin_mm, knot_mm)
    return Places.at(modes, places, _outward(target, places, modes.center_mm))


@lru_cache(maxsize=2)
def _at_walls(target: BoundaryTarget, center_mm: tuple[float, ...]) -> Places:
    modes, places = modes_of(target, center_mm), _walls_mm(target)
    return Places.at(modes, places, _outward(target, places, modes.center_mm))


@lru_cache(maxsize=2)
def _beaten_at_knots_mm(target: BoundaryTarget, center_mm: tuple[float, ...]) -> FloatArray:
    return _beaten_mm(target, knots(*_knots_of(target, center_mm)))


def _beaten_mm(target: BoundaryTarget, places_mm: FloatArray) -> FloatArray:
    """(n,) how far the distance of the boundary changes most over the cycle at (n, 3) places."""
    inner = _within_box(target, places_mm)
    distance = np.stack(
        [target.distance(inner, np.full(len(inner), phase))[0] for phase in range(len(target.fractions))]
    )
    return np.asarray(np.abs(distance - distance[target.rest]).max(axis=0))


def _within_box(target: BoundaryTarget, places_mm: FloatArray) -> FloatArray:
    """(n, 3) places, or the nearest ones in the box of the boundary's splines."""
    box = np.array(target.coefficients.shape[1:]) - 3.0
    inner = np.clip(
        places_mm @ target.knots_from_mm[:, :3].T + target.knots_from_mm[:, 3], INSIDE, box - INSIDE
    )
    return np.asarray((inner - target.knots_from_mm[:, 3]) @ np.linalg.inv(target.knots_from_mm[:, :3]).T)


def _knots_of(target: BoundaryTarget, center_mm: tuple[float, ...]) -> tuple[FloatArray, float]:
    """(3,) first knot of a heart's warps, and their pitch."""
    nodes_mm = modes_of(target, center_mm).nodes_mm
    low, high = nodes_mm.min(axis=0) - MARGIN_MM, nodes_mm.max(axis=0) + MARGIN_MM
    knot_mm = float((high - low).max()) / CELLS
    return np.asarray(0.5 * (low + high - CELLS * knot_mm)), knot_mm


def _walls_mm(target: BoundaryTarget) -> FloatArray:
    """(WALL_PLACES, 3) places in the walls at the first phase."""
    low, high = WALL_MM
    voxels = np.argwhere((target.coefficients[0] > low) & (target.coefficients[0] < high))
    some = voxels[np.linspace(0, len(voxels) - 1, WALL_PLACES).astype(int)]
    knots_mm = (some + 1.0 - target.knots_from_mm[:, 3]) @ np.linalg.inv(target.knots_from_mm[:, :3]).T
    return np.asarray(knots_mm)


def _outward(target: BoundaryTarget, places_mm: FloatArray, center_mm: FloatArray) -> FloatArray:
    """(n, 3) normals of the first phase's boundary nearest to places, or away from the centre without one."""
    inside = _within_box(target, places_mm)
    _, gradient = target.distance(inside, np.zeros(len(inside), dtype=np.int64))
    away = places_mm - center_mm
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    normals = np.where(length > 0.2, target.polarity * gradient, away)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9))
