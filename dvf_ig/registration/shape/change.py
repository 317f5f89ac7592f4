"""The change of the heart's shape since the pre-operative images, where a registration's boundary shows one.

The heart is rigid unless the evidence says otherwise, by more than LEAST_EVIDENCE at the scale of SCALES_MM
where it is largest. The change is a pull-back: what lies at q at the registered pose belongs to q − m(q) in
the model. It contains what the registered pose is off by.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, Rigid, TouchedPoints, Warp, read_only_arrays
from dvf_ig.registration.boundary.fit import Boundary
from dvf_ig.registration.boundary.target import BoundaryTarget
from dvf_ig.registration.pose_chart import DISTINCT_MM

from .blocks import BlockedMatch
from .estimate import (
    AS_IN_MODEL,
    LARGEST_SLOPE,
    MODES,
    Contraction,
    Places,
    ShapeEstimate,
    contracting,
    estimate_of,
    modes_of,
)
from .modes import ShapeModes
from .posterior import ImagedBlocks, SeenBoundary, ShapePosterior, ShapeProblem

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
CONTRACTION_SIGMA = 0.07
"""Standard deviation of a contraction that was found, as a share of the model's; within 1.96 of it is none.
Threshold hearts 2111 to 2116 that contract 0.6 times as far show 0.56 to 0.61, unchanged ones 0.94 to 0.96;
those at 1.3 times show 1.1 to 1.2, if they show it."""
MOST_CONTRACTED = 1.6
"""How many times as far as in the model a heart may contract: more is not the motion of the model."""
LEAST_POINTS = 150
"""Points near the model's boundary below which nothing is said of the shape."""
PATCH_MM, PATCH_POINTS = 30.0, 8
"""Edge of a patch of wall whose shift is stated, and the points it needs."""
LARGEST_RIGID_MM = 1.0
"""RMS shift of the seen walls beyond which a rigid heart will not do: hearts 1.2 mm different, which margins
hold, show up to 0.85 mm. A smaller change that fixtures cannot follow leaves the heart rigid."""
ANOTHER_HEART_MM = 3.5
"""RMS shift of the seen walls beyond which the model may be another patient's: load and filling move the
walls of one heart by up to 5 mm, 3 mm RMS."""
LARGEST_SHARED = 0.7
"""Mean square of the boundary's shared error beyond which what is seen is no change of shape."""
LARGEST_APART_MM = 1.0
"""RMS distance between the seen walls by either half of the frames: at most 0.62 in threshold hearts 5 mm
different."""
LARGEST_PHASES_APART_MM = 0.5
"""RMS distance between the seen walls by systole and by the rest of the cycle up to which a small change is
followed: at most 0.36 in threshold hearts 1.2 mm different (2111 to 2116) whose walls that brings nearer;
0.54 to 1.12 in four, three of which contract otherwise, whose walls it takes further away."""
HELD_OUT_FRAMES = 4
"""Frames in a row that are held out together."""
SYSTOLE = (0.15, 0.55)
"""Phases of the model's cycle between which a heart that contracts otherwise differs most."""
SIDES = (("right", "left"), ("anterior", "posterior"), ("inferior", "superior"))
"""Names of the sides of the heart along the axes of LPS, negative and positive."""


@dataclass(frozen=True, slots=True)
class Halves:
    """Changes of shape by either half of the frames.

    Attributes:
        held_out: misfit of each half by the change that the other shows, over that by the rigid heart; below
            1 if the change explains it better.
        apart_mm: RMS distance between the walls in images by either, along their normals.
    """

    held_out: float
    apart_mm: float


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ShapeChange:
    """A change of the heart's shape, at the pose of the registration that found it.

    Attributes:
        estimate: the change, as beats correct it.
        scale_mm: RMS size of changes that the evidence prefers.
        evidence: logarithm of the odds against a rigid heart.
        seen_mm: RMS shift of the seen walls along their normals.
        wall: which wall has moved most, for example "left anterior"; shift_mm: by how much, positive
            outward; sigma_mm: its standard deviation.
        shared: mean square of the boundary's shared error after the change, see `ShapePosterior`.
        halves: what every second group of frames shows and the others show; None if fixtures cannot follow.
        phases: what systole shows and the rest of the cycle shows, of a small change; None if it is large, or
            the heart contracts otherwise.
        partly: the heart's images cover it in part, so that nothing shows how the rest has changed.
    """

    estimate: ShapeEstimate
    scale_mm: float
    evidence: float
    seen_mm: float
    wall: str
    shift_mm: float
    sigma_mm: float
    shared: float
    halves: Halves | None = None
    phases: Halves | None = None
    partly: bool = False

    @property
    def warp(self) -> Warp:
        """The pull-back m, with the variance of the wall's place along its normal, the pose's included."""
        return self.estimate.warp

    @property
    def needed(self) -> bool:
        """Whether the walls have moved by more than those of a rigid heart may."""
        return self.seen_mm > LARGEST_RIGID_MM

    @property
    def followed(self) -> Warp | None:
        """The warp that fixtures follow; None if they cannot."""
        return self.warp if self.obstacle is None else None

    @property
    def refusal(self) -> str | None:
        """Why the pose must not be used; None if the change can be followed, or need not be."""
        return self.obstacle if self.partly or self.needed else None

    @property
    def obstacle(self) -> str | None:
        """Why fixtures cannot follow the change; None if they can."""
        if self.partly:
            return "the images cover a part of the heart, and do not show how the rest has changed"
        if not 0.0 <= self.estimate.contraction.factor <= MOST_CONTRACTED:
            return "it contracts so differently that the model's motion does not hold"
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
        if self.phases is not None and self.phases.apart_mm > LARGEST_PHASES_APART_MM:
            return "systole shows another change than the rest of the cycle"
        return None

    @property
    def sentence(self) -> str:
        """Which wall lies elsewhere, and by how much."""
        way, contraction = "out" if self.shift_mm > 0 else "in", self.estimate.contraction
        beating = ""
        if contraction != AS_IN_MODEL:
            spread = 1.96 * contraction.sigma
            beating = f"; it contracts {contraction.factor:.2f} times as far (± {spread:.2f})"
        return (
            f"the heart's shape differs from that in the pre-operative images: the {self.wall} wall lies "
            f"{abs(self.shift_mm):.1f} mm further {way} (± {1.96 * self.sigma_mm:.1f}), the seen walls "
            f"{self.seen_mm:.1f} mm RMS{beating}"
        )


def change_of_shape(
    boundary: Boundary,
    offset_mm: float,
    pose: Rigid,
    center_mm: FloatArray,
    organ: BoundaryTarget | None = None,
    match: BlockedMatch | None = None,
    touched: TouchedPoints | None = None,
) -> ShapeChange | None:
    """Estimate the change of shape at a registered pose; None if the boundary shows none.

    A boundary that fits best at another pose says nothing of the shape: None as well.

    Args:
        offset_mm: of the boundary, see `BoundaryFit`.
        organ: outer surface of the organ, which says where its walls are thin.
        match: blocks of images, whose LC2 counts beside the boundary; None: the boundary alone.
        touched: points touched on the organ, which count as well; None without any.
    """
    modes = modes_of(boundary.target, tuple(center_mm.tolist()))
    images = None if match is None else ImagedBlocks(match, pose, modes, MODES)
    seen = SeenBoundary(boundary, offset_mm, pose, organ, touched)
    fit = _most_likely_change(seen, modes, images)
    if fit is None:
        return None
    contraction = _contraction(fit)
    if contraction != AS_IN_MODEL:
        contracted = replace(boundary, target=contracting(boundary.target, contraction.factor))
        outer = organ if organ is None or touched is None else organ.contracting(contraction.factor)
        seen = SeenBoundary(contracted, offset_mm, pose, outer, touched)
        fit = _most_likely_change(seen, modes, images)
        if fit is None:
            return None
    elif fit.evidence < LEAST_EVIDENCE:
        return None
    problem, noise = fit.problem, fit.noise
    best = problem.fit(fit.best.scale_mm, noise, fit.best, images=images)
    estimate = estimate_of(best, noise, problem.level, boundary.target, organ, modes.center_mm, contraction)
    change = _change(estimate, problem, modes, fit.evidence)
    if change.followed is None:
        return change
    frame = np.cumsum(np.diff(problem.model_phase, prepend=0.0) != 0.0)
    odd = frame // HELD_OUT_FRAMES % 2 == 1
    change = replace(change, halves=_halves(problem, odd, best, noise))
    if change.needed or change.followed is None or contraction != AS_IN_MODEL:
        return change
    first, last = SYSTOLE
    systole = (problem.model_phase > first) & (problem.model_phase < last)
    return replace(change, phases=_halves(problem, systole, best, noise))


class _Fit(NamedTuple):
    """The most likely change of shape, its noise, and the logarithm of the odds against a rigid heart."""

    problem: ShapeProblem
    best: ShapePosterior
    noise: float
    evidence: float


def _most_likely_change(seen: SeenBoundary, modes: ShapeModes, images: ImagedBlocks | None) -> _Fit | None:
    """Fit at the noise and the scale that are most likely; None if too little is seen, or another pose."""
    problem = ShapeProblem(seen, modes, MODES)
    if len(problem) < LEAST_POINTS:
        return None
    about = problem.fit(ABOUT_SCALE_MM, NOISE_FACTORS[0], images=images)
    if np.linalg.norm(about.state[:6]) > DISTINCT_MM:
        return None
    problem = ShapeProblem(seen, modes, MODES, about)
    if len(problem) < LEAST_POINTS:
        return None
    best, noise = _most_likely(problem, about)
    return _Fit(problem, best, noise, best.log_evidence - problem.fit(0.0, noise).log_evidence)


def _contraction(fit: _Fit) -> Contraction:
    """How far the heart contracts, if the boundary shows that it is not as far as in the model.

    A heart that contracts otherwise need not have changed its shape, though it looks like it.
    """
    problem, best, noise = fit.problem, fit.best, fit.noise
    changed = problem.fit(best.scale_mm, noise, best, contraction=True)
    rigid = problem.fit(0.0, noise, contraction=True)
    likely = max(changed, rigid, key=lambda one: one.log_evidence)
    before = max(best.log_evidence, best.log_evidence - fit.evidence)
    further = float(likely.state[-1])
    if likely.log_evidence - before < LEAST_EVIDENCE or abs(further) < 1.96 * CONTRACTION_SIGMA:
        return AS_IN_MODEL
    return Contraction(1.0 + further, CONTRACTION_SIGMA)


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


def _halves(problem: ShapeProblem, some: BoolArray, best: ShapePosterior, noise: float) -> Halves:
    """Compare the changes that some points show and that the others do, with the points of either."""
    halves = [problem.part(part) for part in (some, ~some)]
    if min(len(half) for half in halves) < LEAST_POINTS:
        return Halves(np.inf, np.inf)
    changed = rigid = 0.0
    shifts = []
    for half, other in (halves, halves[::-1]):
        rigid += other.misfit(half.fit(0.0, noise))
        fit = half.fit(best.scale_mm, noise, best)
        changed += other.misfit(fit)
        shifts.append(problem.shift_mm(fit))
    return Halves(changed / rigid, _rms((shifts[0] - shifts[1])[~problem.touched]))


def _change(
    estimate: ShapeEstimate, problem: ShapeProblem, modes: ShapeModes, evidence: float
) -> ShapeChange:
    """Evaluate the fit at the seen walls."""
    best, seen = estimate.posterior, Places.at(modes, problem.places_mm, problem.outward)
    shift = np.einsum("ni,ni->n", problem.outward, seen.pulled_mm(best))
    wall, shift_mm, sigma_mm = _most_moved(problem, modes.center_mm, shift, seen.variance_mm2(best))
    return ShapeChange(
        estimate=estimate,
        scale_mm=best.scale_mm,
        evidence=float(evidence),
        seen_mm=_rms(shift),
        wall=wall,
        shift_mm=shift_mm,
        sigma_mm=sigma_mm,
        shared=best.shared,
    )


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
