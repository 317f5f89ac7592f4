"""The change of the heart's shape since the pre-operative images, where a registration's boundary shows one.

The heart is rigid unless the evidence says otherwise, by more than LEAST_EVIDENCE at the scale of SCALES_MM
where it is largest. The change is a pull-back: what lies at q at the registered pose belongs to q − m(q) in
the model. It contains what the registered pose is off by.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from dvf_ig.core import FloatArray, Rigid, Warp, read_only_arrays
from dvf_ig.core.space.warp import CELLS, knots
from dvf_ig.kernels.boundary import DistanceSplines, boundary_distances
from dvf_ig.kernels.warp import LARGEST_MM2
from dvf_ig.registration.boundary.fit import Boundary
from dvf_ig.registration.boundary.target import BoundaryTarget
from dvf_ig.registration.pose_chart import DISTINCT_MM, rigid_motion

from .blocks import BlockedMatch
from .modes import ShapeModes, shape_modes
from .posterior import FIXED, SeenBoundary, ShapePosterior, ShapeProblem

MODES = 200
"""Modes of a change of shape. With points exactly on the boundary of a heart 5 mm different, 100 leave 1.1 mm
where the wall is seen, 200 and 400 leave 0.8; 30 leave 2.1 mm even if every point is matched to itself."""
SCALES_MM = (6.0, 3.0, 1.5, 0.75)
ABOUT_SCALE_MM = 3.0
"""Scale of the first fit, at whose change of shape the points are compared with the model's edges again."""
QUICK_STEPS = 2
"""Steps of fits whose evidence alone is compared."""
NOISE_FACTORS = (1.0, 1.5, 2.25, 3.4)
NOISE_SCALE_MM = 1.5
"""The boundary's errors are those of calm images, or larger, as the evidence at this scale prefers: else the
errors of poor images would count as a change of shape."""
LEAST_EVIDENCE = 20.0
"""Logarithm of the odds against a rigid heart from which its shape counts as changed: up to 16 in ten
threshold hearts that have not."""
LEAST_POINTS = 150
"""Points near the model's boundary below which nothing is said of the shape."""
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
PATCH_MM, PATCH_POINTS = 30.0, 8
"""Edge of a patch of wall whose shift is stated, and the points it needs."""
LARGEST_RIGID_MM = 1.0
"""RMS shift of the seen walls up to which fixtures stay rigid: hearts 1.2 mm different, which margins hold,
show up to 0.85 mm, and following them brings the wall no nearer to the truth (docs/decisions/0042)."""
PLAINLY_RIGID_MM = 0.8
"""RMS shift of the seen walls by the first fit below which the heart is taken to be rigid: in threshold
hearts 2101 to 2110, up to 5 mm different, the last fit has between 0.1 mm less and a fifth more."""
ANOTHER_HEART_MM = 3.5
"""RMS shift of the seen walls beyond which the model may be another patient's: load and filling move the
walls of one heart by up to 5 mm, 3 mm RMS."""
LARGEST_SLOPE = 0.5
"""Largest ‖Dm‖: 0.43 in threshold hearts 5 mm different, where the wall is right; folds begin at 1."""
LARGEST_SHARED = 0.7
"""Mean square of the boundary's shared error beyond which what is seen is no change of shape."""
LARGEST_APART_MM = 1.0
"""RMS distance between the seen walls by either half of the frames: at most 0.62 in threshold hearts 5 mm
different."""
HELD_OUT_FRAMES = 4
"""Frames in a row that are held out together."""
SIDES = (("right", "left"), ("anterior", "posterior"), ("inferior", "superior"))
"""Names of the sides of the heart along the axes of LPS, negative and positive."""


@dataclass(frozen=True, slots=True)
class Halves:
    """Changes of shape by either half of the frames.

    Attributes:
        held_out: misfit of each half by the change that the other shows, over that by the rigid heart; below
            1 if the change explains it better.
        apart_mm: RMS distance between the seen walls by either, along their normals.
    """

    held_out: float
    apart_mm: float


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
class ShapeChange:
    """A change of the heart's shape, at the pose of the registration that found it.

    Attributes:
        warp: the pull-back m, with the variance of the wall's place along its normal, the pose's included.
        scale_mm: RMS size of changes that the evidence prefers.
        evidence: logarithm of the odds against a rigid heart.
        seen_mm: RMS shift of the seen walls along their normals.
        wall: which wall has moved most, for example "left anterior"; shift_mm: by how much, positive
            outward; sigma_mm: its standard deviation.
        shared: mean square of the boundary's shared error after the change, see `ShapePosterior`.
        halves: what every second group of frames shows and the others show, and guarded: walls at which a
            force may be given; None if nothing is to follow the change.
        partly: the heart's images cover it in part, so that nothing shows how the rest has changed.
    """

    warp: Warp
    scale_mm: float
    evidence: float
    seen_mm: float
    wall: str
    shift_mm: float
    sigma_mm: float
    shared: float
    halves: Halves | None = None
    guarded: GuardedWalls | None = None
    partly: bool = False

    @property
    def needed(self) -> bool:
        """Whether the walls have moved by more than those of a rigid heart may."""
        return self.seen_mm > LARGEST_RIGID_MM

    @property
    def followed(self) -> Warp | None:
        """The warp that fixtures follow; None if they need not, or cannot."""
        return self.warp if self.needed and self.refusal is None else None

    @property
    def refusal(self) -> str | None:
        """Why fixtures cannot follow a change that they would have to; None if they can, or need not."""
        if self.partly:
            return "the images cover a part of the heart, and do not show how the rest has changed"
        if not self.needed:
            return None
        if self.seen_mm > ANOTHER_HEART_MM:
            return "it has changed by more than load and filling change a heart"
        if self.warp.steepest > LARGEST_SLOPE:
            return "it has changed too abruptly for the model to follow"
        if self.shared > LARGEST_SHARED:
            return "the change leaves errors in the images that no shape explains"
        if self.halves is not None and self.halves.held_out >= 1.0:
            return "the change does not explain frames that were held out"
        if self.halves is not None and self.halves.apart_mm > LARGEST_APART_MM:
            return "half of the frames show another change than the others"
        return None

    @property
    def sentence(self) -> str:
        """Which wall lies elsewhere, and by how much."""
        way = "out" if self.shift_mm > 0 else "in"
        return (
            f"the heart's shape differs from that in the pre-operative images: the {self.wall} wall lies "
            f"{abs(self.shift_mm):.1f} mm further {way} (± {1.96 * self.sigma_mm:.1f}), the seen walls "
            f"{self.seen_mm:.1f} mm RMS"
        )


def change_of_shape(
    boundary: Boundary,
    offset_mm: float,
    pose: Rigid,
    center_mm: FloatArray,
    organ: BoundaryTarget | None = None,
    least_mm: float = PLAINLY_RIGID_MM,
    match: BlockedMatch | None = None,
) -> ShapeChange | None:
    """Estimate the change of shape at a registered pose; None if the boundary shows none.

    A boundary that fits best at another pose says nothing of the shape: None as well.

    Args:
        offset_mm: of the boundary, see `BoundaryFit`.
        organ: outer surface of the organ, which says where its walls are thin.
        least_mm: RMS shift of the seen walls by the first fit below which nothing further is computed.
        match: blocks of images, whose LC2 counts beside the boundary; None: the boundary alone.
    """
    modes = modes_of(boundary.target, tuple(center_mm.tolist()))
    seen = SeenBoundary(boundary, offset_mm, pose, organ, match)
    problem = ShapeProblem(seen, modes, MODES)
    if len(problem) < LEAST_POINTS:
        return None
    about = problem.fit(ABOUT_SCALE_MM, NOISE_FACTORS[0], images=True)
    if np.linalg.norm(about.state[:6]) > DISTINCT_MM or _rms(problem.shift_mm(about)) < least_mm:
        return None
    problem = ShapeProblem(seen, modes, MODES, about)
    if len(problem) < LEAST_POINTS:
        return None
    best, noise = _most_likely(problem, about)
    evidence = best.log_evidence - problem.fit(0.0, noise).log_evidence
    if evidence < LEAST_EVIDENCE:
        return None
    best = problem.fit(best.scale_mm, noise, best, images=True)
    change = _change(boundary.target, problem, modes, best, evidence)
    if change.followed is None:
        return change
    guarded = _guarded_walls(boundary.target, modes, best)
    return replace(change, halves=_halves(problem, best, noise), guarded=guarded)


def _most_likely(problem: ShapeProblem, about: ShapePosterior) -> tuple[ShapePosterior, float]:
    """Fit at the noise and the scale where the evidence is largest; return the fit and its noise.

    Few steps of a fit show by how much its evidence differs from another's.
    """

    def quick(scale_mm: float, noise: float, begin: ShapePosterior) -> ShapePosterior:
        return problem.fit(scale_mm, noise, begin, steps=QUICK_STEPS)

    fits, noise = {NOISE_SCALE_MM: quick(NOISE_SCALE_MM, NOISE_FACTORS[0], about)}, NOISE_FACTORS[0]
    for larger in NOISE_FACTORS[1:]:
        tried = quick(NOISE_SCALE_MM, larger, about)
        if tried.log_evidence < fits[NOISE_SCALE_MM].log_evidence:
            break
        fits[NOISE_SCALE_MM], noise = tried, larger
    begin = about
    for scale_mm in SCALES_MM:
        if scale_mm not in fits:
            fits[scale_mm] = quick(scale_mm, noise, begin)
        begin = fits[scale_mm]
    evidence = np.array([fits[scale_mm].log_evidence for scale_mm in SCALES_MM])
    k = min(max(int(np.argmax(evidence)), 1), len(SCALES_MM) - 2)
    before, here, after = evidence[k - 1 : k + 2]
    bend = min(before + after - 2.0 * here, -1e-9)
    part = float(np.clip(0.5 * (before - after) / bend, -1.0, 1.0))
    scale_mm = SCALES_MM[k] * (SCALES_MM[1] / SCALES_MM[0]) ** part
    return problem.fit(scale_mm, noise, fits[SCALES_MM[k]]), noise


def _halves(problem: ShapeProblem, best: ShapePosterior, noise: float) -> Halves:
    """Compare the changes that either half of the frames shows, with the other half and with each other."""
    frame = np.cumsum(np.diff(problem.model_phase, prepend=0.0) != 0.0)
    odd = frame // HELD_OUT_FRAMES % 2 == 1
    halves = [problem.part(part) for part in (odd, ~odd)]
    if min(len(half) for half in halves) < LEAST_POINTS:
        return Halves(np.inf, np.inf)
    changed = rigid = 0.0
    shifts = []
    for half, other in (halves, halves[::-1]):
        rigid += other.misfit(half.fit(0.0, noise))
        fit = half.fit(best.scale_mm, noise, best)
        changed += other.misfit(fit)
        shifts.append(problem.shift_mm(fit))
    return Halves(changed / rigid, _rms(shifts[0] - shifts[1]))


def _change(
    target: BoundaryTarget, problem: ShapeProblem, modes: ShapeModes, best: ShapePosterior, evidence: float
) -> ShapeChange:
    """Evaluate the fit on the knots, and at the seen walls."""
    pulled, variance = _field(modes, best, problem.places_mm, problem.outward)
    shift = np.einsum("ni,ni->n", problem.outward, pulled)
    wall, shift_mm, sigma_mm = _most_moved(problem, modes.center_mm, shift, variance)
    low, high = modes.nodes_mm.min(axis=0) - MARGIN_MM, modes.nodes_mm.max(axis=0) + MARGIN_MM
    knot_mm = float((high - low).max()) / CELLS
    origin_mm = 0.5 * (low + high - CELLS * knot_mm)
    places = knots(origin_mm, knot_mm)
    pulled, variance = _field(modes, best, places, _outward(target, places, modes.center_mm))
    return ShapeChange(
        warp=Warp.through(target.frame, origin_mm, knot_mm, pulled, variance),
        scale_mm=best.scale_mm,
        evidence=float(evidence),
        seen_mm=_rms(shift),
        wall=wall,
        shift_mm=shift_mm,
        sigma_mm=sigma_mm,
        shared=best.shared,
    )


def _field(
    modes: ShapeModes, best: ShapePosterior, places_mm: FloatArray, normals: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(n, 3) pull-back m at (n, 3) places, and (n,) variance of q − m(q) along (n, 3) normals."""
    moved, motion = modes.at(places_mm, MODES), rigid_motion(places_mm, modes.center_mm)
    columns, alone = _known_along(modes, best, places_mm, normals, moved)
    return moved @ best.state[FIXED:] - motion @ best.state[:6], (columns**2).sum(axis=1) + alone


def _known_along(
    modes: ShapeModes, best: ShapePosterior, places_mm: FloatArray, normals: FloatArray, moved: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(n, k) F and (n,) v: the errors of q − m(q) along normals have the covariance F Fᵀ + diag(v).

    Args:
        moved: (n, 3, MODES) of the modes at the (n, 3) places.
    """
    along = np.einsum("ni,nik->nk", normals, moved)
    motion = np.einsum("ni,nip->np", normals, rigid_motion(places_mm, modes.center_mm))
    kept = np.r_[:6, FIXED : len(best.state)]  # all but the offsets
    known = np.linalg.cholesky(best.covariance_mm2[np.ix_(kept, kept)])
    left_out = modes.variance_along(places_mm, normals) - (along**2).sum(axis=1)
    alone = SIGMA_FACTOR**2 * best.scale_mm**2 * np.maximum(left_out, 0.0)
    floor = SIGMA_FLOOR_MM**2 + (SIGMA_SHARE * best.scale_mm) ** 2
    return SIGMA_FACTOR * np.concatenate([motion, -along], axis=1) @ known, alone + floor


def _guarded_walls(target: BoundaryTarget, modes: ShapeModes, best: ShapePosterior) -> GuardedWalls:
    """Evaluate the fit at walls whose place is certain enough for a force, or at all if none is."""
    places = _walls_mm(target)
    normals = _outward(target, places, modes.center_mm)
    columns, alone = _known_along(modes, best, places, normals, modes.at(places, MODES))
    variance = (columns**2).sum(axis=1) + alone
    served = variance <= LARGEST_MM2
    if not served.any():
        served[:] = True
    columns, variance = columns[served], float(variance[served].mean())
    motion = np.einsum("ni,nip->np", normals, rigid_motion(places, modes.center_mm))[served]
    # what the fit leaves out is taken to have the correlation of what it states
    alike = float(((columns.T @ columns) ** 2).sum() / (columns**2).sum() ** 2)
    return GuardedWalls(motion.T @ motion / len(motion), variance, variance**2 * (alike + SCALE_SPREAD))


def _most_moved(
    problem: ShapeProblem, center_mm: FloatArray, shift_mm: FloatArray, variance_mm2: FloatArray
) -> tuple[str, float, float]:
    """Name, mean shift and standard deviation of the patch of the outer walls that has moved most."""
    places, from_center = problem.places_mm, problem.places_mm - center_mm
    facing = np.einsum("ni,ni->n", problem.outward, from_center)
    outer = np.flatnonzero(facing > 0.5 * np.linalg.norm(from_center, axis=1))
    if not len(outer):  # inner walls alone are seen
        outer = np.arange(len(places))
    _, patch = np.unique(np.floor(places[outer] / PATCH_MM), axis=0, return_inverse=True)
    patch = patch.ravel()
    count = np.bincount(patch)
    mean = np.bincount(patch, shift_mm[outer]) / count
    k = int(np.argmax(np.where(count >= min(PATCH_POINTS, count.max()), np.abs(mean), -1.0)))
    of_patch = outer[patch == k]
    return (
        _side(from_center[of_patch].mean(axis=0)),
        float(mean[k]),
        float(np.sqrt(variance_mm2[of_patch]).mean()),
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _side(direction: FloatArray) -> str:
    """Name of the side of the heart in a direction, LPS."""
    share = direction / np.linalg.norm(direction)
    return " ".join(SIDES[axis][int(share[axis] > 0)] for axis in range(3) if abs(share[axis]) > 0.5)


@lru_cache(maxsize=2)
def modes_of(target: BoundaryTarget, center_mm: tuple[float, ...]) -> ShapeModes:
    """Modes over the walls of a heart, which all its registrations share."""
    return shape_modes(_walls_mm(target), np.array(center_mm))


def _walls_mm(target: BoundaryTarget) -> FloatArray:
    """(WALL_PLACES, 3) places in the walls at the first phase."""
    low, high = WALL_MM
    voxels = np.argwhere((target.coefficients[0] > low) & (target.coefficients[0] < high))
    some = voxels[np.linspace(0, len(voxels) - 1, WALL_PLACES).astype(int)]
    knots_mm = (some + 1.0 - target.knots_from_mm[:, 3]) @ np.linalg.inv(target.knots_from_mm[:, :3]).T
    return np.asarray(knots_mm)


def _outward(target: BoundaryTarget, places_mm: FloatArray, center_mm: FloatArray) -> FloatArray:
    """(n, 3) normals of the first phase's boundary nearest to places, or away from the centre without one."""
    box = np.array(target.coefficients.shape[1:]) - 3.0
    knots = np.clip(places_mm @ target.knots_from_mm[:, :3].T + target.knots_from_mm[:, 3], 0.0, box)
    inside = (knots - target.knots_from_mm[:, 3]) @ np.linalg.inv(target.knots_from_mm[:, :3]).T
    distance, gradient = np.empty(len(inside)), np.empty((len(inside), 3))
    splines = DistanceSplines(target.coefficients, target.knots_from_mm, target.polarity)
    boundary_distances(splines, np.zeros(len(inside), dtype=np.int64), inside, distance, gradient)
    away = places_mm - center_mm
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    normals = np.where(length > 0.2, target.polarity * gradient, away)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9))
