"""Register ECG-gated ultrasound to the pre-operative heart, from a coarse start to a pose with evidence."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dvf_ig.core import Rigid, Stop, TouchedPoints, mean_displacement_mm, untold
from dvf_ig.registration.boundary.target import target_from_model
from dvf_ig.registration.evidence.assessment import (
    Assessment,
    ImageStatistics,
    Table,
    assess,
    features_of,
    image_statistics,
    table_of,
)
from dvf_ig.registration.evidence.checks import (
    Evidence,
    limits_of_part,
    part_disagreements,
    wrong_pose_z_score,
)
from dvf_ig.registration.evidence.image_offset import ImageOffset, fit_image_offset, shape_log_ratio
from dvf_ig.registration.evidence.phase_offset import phase_offset
from dvf_ig.registration.lc2.lc2 import Lc2, SliceThreads
from dvf_ig.registration.shape.change import ShapeChange, change_of_shape
from dvf_ig.registration.surface_points.touched import TouchedSurface

from .coverage import Coverage
from .fuse import Fused, fuse
from .images import HeartTarget, Problem, RegistrationOptions, UltrasoundImages
from .pose_chart import DISTINCT_MM, PoseChart, largest_error_bound_mm, predicted_error_mm
from .result import RegistrationResult
from .search import Refined, find_candidates, refine
from .start import LandmarkFit, LandmarkPrior, landmarks_disagree

LARGEST_OF_PART_MM = 8.0
"""Bound on the largest error over the covered part of a heart above which its pose is refused: 1.6 times the
5 mm of RMS error there from which on a session withholds a pose, as covariances of stacks have it."""
PART_EVIDENCE = 255.0
"""Evidence of a change of shape from which a heart known from a short-axis stack alone is refused, where a
sweep images all of the covered part; where it images a share, that share of it. Shifts between breath-holds
and the rounding between slices look like a change too: calm sweeps of threshold hearts stay below 250; of
hearts changed by 1 to 5 mm, those that end more than 5 mm off are above 265."""


def register(
    images: UltrasoundImages,
    heart: HeartTarget,
    start: Rigid,
    *,
    rng: np.random.Generator,
    clock: Callable[[], float],
    landmarks: LandmarkPrior | None = None,
    touched: TouchedPoints | None = None,
    progress: Callable[[float], None] | None = None,
) -> RegistrationResult:
    """Register ultrasound to the phase-matched model (docs/theory/registration.md).

    Args:
        images: slices of tracked frames or of gated volumes.
        start: target_from_source to start from.
        rng: draws the displaced starts and the wrong poses.
        clock: seconds from any origin, for the result's `seconds`; nothing else depends on it.
        landmarks: touched landmarks that the pose, or the probe's calibration alone, must also agree with.
        touched: points touched on the heart's surface, which show its shape beside the images.
        progress: called with the fraction done.
    Returns:
        the most likely pose, its evidence, and whether it may be used.
    """
    began, report = clock(), progress or untold
    if heart.covered is not None:
        options = images.options
        images = replace(images, options=replace(options, limits=limits_of_part(options.limits)))
    with SliceThreads() as threads:
        in_search = landmarks if landmarks is not None and landmarks.in_search else None
        problem = Problem(images, heart, in_search, threads)
        coarse = problem.coarse_lc2()  # section 4: LC2 as a function of the pose
        candidates = find_candidates(  # section 3: many starts by the boundary, optimised on coarse slices
            problem, coarse, start, rng=rng, report_progress=lambda x: report(0.4 * x)
        )
        report(0.5)
        refined = refine(  # section 4: the best distinct ones on fine slices
            problem, candidates, report_progress=lambda x: report(0.6 + 0.2 * x)
        )
        fused = fuse(problem, refined)  # section 5: with the boundary, pose and change of shape together
        covered, shown = heart.covered, images.coarse.slices
        if covered is not None:  # the evidence is of the part of the heart that its images cover
            shown = fused.covered.subset(np.flatnonzero(fused.covered.masks.any(axis=(1, 2))))
            coarse = problem.coarse_lc2(shown)
        coverage = None if covered is None else covered.imaged_by(shown, fused.pose)
        # section 5b: is the heart the one in the model?
        shape = _change_of_shape(problem, fused, coverage, touched)
        report(0.95)
        evidence = _evidence(problem, coarse, refined, fused, shape, landmarks, rng)  # trust.md: every check
        inside = refined.inside.score(fused.pose)
        similarity = inside.similarity
        overlap = refined.whole.score(fused.pose).overlap if coverage is None else coverage.share
        moved_mm = mean_displacement_mm(start, fused.pose, heart.center_mm)
        statistics = image_statistics(
            shown,
            similarity=similarity,
            overlap=overlap if coverage is None else inside.overlap,
            information=refined.inside.information,
        )
        explained = shape is not None and shape.needed and shape.followed is not None
        unexplained = evidence.of_changed_shape() if explained else evidence
        stop = _stop(images.options, refined, fused, unexplained, moved_mm=moved_mm, overlap=overlap)
        if shape is not None and shape.refusal is not None and stop in (Stop.CONVERGED, Stop.DISAGREEMENT):
            stop = Stop.CHANGED_SHAPE  # also why parts disagree on where a rigid heart is
        if stop in (Stop.CONVERGED, Stop.CHANGED_SHAPE) and covered is None and _other_calibration(evidence):
            stop = Stop.DISAGREEMENT  # an image that lies elsewhere on its probe looks like another shape
        share = None if coverage is None else coverage.share
        stop, assessment = _assessed(  # trust.md: probability, bound and scale of the covariance
            stop,
            table_of(images.options.kind, "" if covered is None else covered.kind),
            features_of(evidence, similarity, predicted_error_mm(fused.covariance), share),
            features_of(unexplained, similarity, predicted_error_mm(fused.covariance), share),
            statistics,
            None
            if covered is None
            else largest_error_bound_mm(fused.covariance, covered.surface_mm, heart.center_mm),
        )
        result = RegistrationResult(
            target_from_source=fused.pose,
            start=start,
            stop=stop,
            success_probability=assessment.success_probability,
            tre_bound_mm=assessment.tre_bound_mm,
            covariance=fused.covariance * assessment.covariance_scale,
            covariance_scale=assessment.covariance_scale,
            noise_covariance=fused.noise_covariance,
            center_mm=heart.center_mm,
            evidence=evidence,
            statistics=statistics,
            outside=assessment.outside,
            similarity=similarity,
            start_similarity=refined.inside.score(start).similarity,
            overlap=overlap,
            second_best=_second_best(problem, refined, fused.pose),
            moved_mm=moved_mm,
            evaluations=candidates.evaluations + refined.evaluations,
            seconds=images.seconds + clock() - began,
            slices=len(images.fine.slices),
            options=images.options,
            matched=refined.best.pose,
            coverage=coverage,
            shape=shape,
        )
    report(1.0)
    return result


def _evidence(
    problem: Problem,
    coarse: Lc2,
    refined: Refined,
    fused: Fused,
    shape: ShapeChange | None,
    marks: LandmarkPrior | None,
    rng: np.random.Generator,
) -> Evidence:
    """Test the pose by subsets of the slices, wrong poses, the boundary and shifts of the phase."""
    best, center_mm, rr_s = refined.best.pose, problem.center_mm, problem.images.rr_s
    parts = part_disagreements(fused.covered, problem.coarse_lc2, best, center_mm)
    return Evidence(
        z_score=wrong_pose_z_score(coarse, PoseChart(best, center_mm), rng),
        split_half_mm=parts.split_half_mm,
        phase_mm=parts.phase_mm,
        half_volume_mm=parts.half_volume_mm,
        boundary_mm=_boundary_distance_mm(problem, best, fused),
        phase_offset=None if rr_s is None else phase_offset(coarse, fused.pose, rr_s),
        image_offset=_image_offset(problem, best, fused, shape, marks),
    )


def _other_calibration(evidence: Evidence) -> bool:
    """Whether the views contradict the probe calibration; of a heart covered in part they cannot say."""
    return evidence.image_offset is not None and evidence.image_offset.suspicious


def _image_offset(
    problem: Problem,
    pose: Rigid,
    fused: Fused,
    shape: ShapeChange | None,
    marks: LandmarkPrior | None,
) -> ImageOffset | None:
    """How the image lies to its probe by the views; None if the probe is not to be checked.

    Args:
        pose: of the best match; fused, shape: the pose with a change of shape.
        marks: touched landmarks, which say nothing of the probe once the heart has changed its shape.
    """
    probe = problem.images.probe
    if probe is None:
        return None
    metric = problem.coarse_lc2(problem.compared(problem.images.coarse, pose))
    if shape is None or not shape.needed:
        return fit_image_offset(probe, metric, pose, problem.center_mm, marks)
    offset = fit_image_offset(probe, metric, pose, problem.center_mm)
    explained = shape_log_ratio(metric, pose, fused.pose, shape.warp, problem.center_mm)
    return replace(offset, shape_log_ratio=explained)


def _boundary_distance_mm(problem: Problem, pose: Rigid, fused: Fused) -> float | None:
    """Distance of the boundary's pose; inf where the slices show none of the model's boundary."""
    if problem.boundary is None:
        return None
    if fused.boundary is None:
        return float("inf")
    return mean_displacement_mm(pose, fused.boundary.pose, problem.center_mm)


def _change_of_shape(
    problem: Problem, fused: Fused, coverage: Coverage | None, touched: TouchedPoints | None
) -> ShapeChange | None:
    """The change of shape at the pose; of a stack alone, one that only another heart shows.

    With long-axis views it is not looked for.
    """
    boundary = None if coverage is not None and coverage.views else problem.boundary_at(fused.pose)
    if boundary is None or fused.boundary is None:
        return None
    model = problem.heart.model
    organ = None if model is None else target_from_model(model)
    offset_mm, center_mm = fused.boundary.offset_mm, problem.center_mm
    match = fused.match if coverage is None else None
    change = change_of_shape(boundary, offset_mm, fused.pose, center_mm, organ, match, touched)
    if coverage is None or change is None:
        return change
    return replace(change, partly=True) if change.evidence > PART_EVIDENCE * coverage.share else None


def _second_best(problem: Problem, refined: Refined, pose: Rigid) -> float:
    """LC2 of the best candidate that lies elsewhere; 0 if there was none."""
    others = [
        problem.fine_lc2(problem.compared(problem.images.fine, other.pose)).score(other.pose).similarity
        if problem.heart.covered is not None
        else refined.whole.score(other.pose).similarity
        for other in refined.optima[1:]
        if mean_displacement_mm(other.pose, pose, problem.center_mm) > DISTINCT_MM
    ]
    return max(others, default=0.0)


def _stop(
    options: RegistrationOptions,
    refined: Refined,
    fused: Fused,
    evidence: Evidence,
    *,
    moved_mm: float,
    overlap: float,
) -> Stop:
    """How the registration ended: the first check that is against the pose, or CONVERGED.

    Args:
        moved_mm: mean distance over the heart from the start.
        overlap: share of the slices inside the model's volume, or of the covered part that they image.
    """
    if overlap < options.min_overlap:
        return Stop.LOW_OVERLAP
    if evidence.z_score < options.limits.z_score:
        return Stop.POOR_MATCH
    if evidence.phase_offset is not None and evidence.phase_offset.suspicious:
        return Stop.PHASE_OFFSET
    if moved_mm > options.bound_mm:
        return Stop.MOVED_TOO_FAR
    if not refined.best.converged:
        return Stop.MAX_ITERATIONS
    if not np.isfinite(fused.covariance).all():
        return Stop.WEAK_GEOMETRY
    if evidence.worst_test_ratio(options.limits) > 1.0:
        return Stop.DISAGREEMENT
    return Stop.CONVERGED


def _assessed(
    stop: Stop,
    table: Table | None,
    features: dict[str, float | None],
    unexplained: dict[str, float | None],
    statistics: ImageStatistics,
    of_part_mm: float | None,
) -> tuple[Stop, Assessment]:
    """State the error that may be expected, and refuse a pose whose checks together are too bad.

    For a pose that its checks refused no bound is stated, and no more than the share of successes among
    refused ones. For images unlike all that was calibrated neither is stated, and the pose is judged as if
    they were like those; where nothing was calibrated for their kind, the checks' own limits decide.

    Args:
        features: by which probability and bound are stated; unexplained: without what a change of the heart's
            shape that fixtures follow explains, by which the pose is judged.
        of_part_mm: bound on the largest error over the covered part by the covariance before it is scaled;
            None if the heart's images cover all of it. What they do not cover pulls poses aside by more than
            any check's limit shows: without a bound up to LARGEST_OF_PART_MM such a pose is UNBOUNDED, which
            may renew a pose in use, but begin none.
    """
    assessment = replace(
        assess(table, features, statistics), doubtful=assess(table, unexplained, statistics).doubtful
    )
    if of_part_mm is not None and table is not None and not assessment.outside:
        scaled_mm = math.sqrt(assessment.covariance_scale) * of_part_mm
        assessment = replace(assessment, tre_bound_mm=scaled_mm)
    if stop.usable and not assessment.doubtful:
        bound_mm = assessment.tre_bound_mm
        if of_part_mm is None or (bound_mm is not None and bound_mm <= LARGEST_OF_PART_MM):
            return stop, assessment
        return Stop.UNBOUNDED, assessment
    chance = assessment.success_probability
    if not stop.usable and table is not None and chance is not None:
        chance = min(chance, table.refused_probability)
    refused = replace(assessment, success_probability=chance, tre_bound_mm=None)
    return (Stop.DOUBTFUL if stop.usable else stop), refused


def against_touched(
    result: RegistrationResult, landmarks: LandmarkFit | None, touched: TouchedSurface | None
) -> RegistrationResult:
    """Compare a pose with what was touched on the patient; it ends in DISAGREEMENT if that lies elsewhere.

    Args:
        landmarks: fit of touched landmarks through a change of shape that fixtures follow; None without any.
        touched: points touched on the heart's surface; None without any.
    """
    pose = result.target_from_source
    warp = None if result.shape is None else result.shape.followed
    apart_mm = None if landmarks is None else mean_displacement_mm(pose, landmarks(warp), result.center_mm)
    surface = None if touched is None else touched.disagreement(pose, warp)
    checked = replace(result, landmarks_mm=apart_mm, touched=surface)
    elsewhere = landmarks_disagree(apart_mm) or (surface is not None and not surface.agrees)
    return checked.refused(Stop.DISAGREEMENT) if elsewhere and result.stop.usable else checked
