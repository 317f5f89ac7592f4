"""Judgement of a registered pose: the evidence for it, and whether it may be used."""

from dataclasses import replace

import numpy as np

from dvf_ig.core import Rigid, Stop, mean_displacement_mm
from dvf_ig.registration.evidence.assessment import Assessment, ImageStatistics, Table, assess
from dvf_ig.registration.evidence.checks import Evidence, part_disagreements, wrong_pose_z_score
from dvf_ig.registration.evidence.phase_offset import phase_offset
from dvf_ig.registration.lc2.lc2 import Lc2
from dvf_ig.registration.search import Refined

from .data import RegistrationData, RegistrationOptions
from .fuse import Fused
from .pose_chart import DISTINCT_MM, PoseChart


def gather_evidence(
    data: RegistrationData,
    coarse: Lc2,
    refined: Refined,
    fused: Fused,
    *,
    rng: np.random.Generator,
) -> Evidence:
    """What the pose is tested by.

    Args:
        coarse: LC2 on the coarse slices.
        rng: draws the wrong poses.
    """
    best = refined.best.pose
    parts = part_disagreements(fused.covered, fused.metric_of, best, data.center_mm)
    return Evidence(
        z_score=wrong_pose_z_score(coarse, PoseChart(best, data.center_mm), rng),
        split_half_mm=parts.split_half_mm,
        phase_mm=parts.phase_mm,
        half_volume_mm=parts.half_volume_mm,
        boundary_mm=_boundary_distance_mm(data, best, fused),
        phase_offset=None if data.rr_s is None else phase_offset(coarse, fused.pose, data.rr_s),
    )


def _boundary_distance_mm(data: RegistrationData, pose: Rigid, fused: Fused) -> float | None:
    """Distance of the boundary's pose; inf where the slices show none of the model's boundary."""
    if data.boundary is None:
        return None
    if fused.boundary is None:
        return float("inf")
    return mean_displacement_mm(pose, fused.boundary.pose, data.center_mm)


def second_best(data: RegistrationData, refined: Refined, pose: Rigid) -> float:
    """LC2 of the best candidate that lies elsewhere; 0 if there was none."""
    others = [
        refined.whole.score(other.pose).similarity
        for other in refined.optima[1:]
        if mean_displacement_mm(other.pose, pose, data.center_mm) > DISTINCT_MM
    ]
    return max(others, default=0.0)


def stop_of(
    refined: Refined,
    fused: Fused,
    evidence: Evidence,
    *,
    moved_mm: float,
    overlap: float,
    options: RegistrationOptions,
) -> Stop:
    """How the registration ended: the first check that is against the pose, or CONVERGED.

    Args:
        moved_mm: mean distance over the heart from the start.
        overlap: share of the slices inside the model's volume.
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


def assessed(
    stop: Stop, table: Table | None, features: dict[str, float | None], statistics: ImageStatistics
) -> tuple[Stop, Assessment]:
    """What may be said of the error, and how the registration ended in the light of it.

    Of a pose that a check refused no bound is stated, and no more than the share of successes among refused
    ones. Of images unlike all that was calibrated neither is stated, and the pose is
    judged as of those that were; where nothing was calibrated for their kind, the checks' own limits decide.
    """
    found = assess(table, features, statistics)
    if not stop.usable:
        if table is None or found.success_probability is None:
            return stop, replace(found, success_probability=None, tre_bound_mm=None)
        chance = min(found.success_probability, table.refused_probability)
        return stop, replace(found, success_probability=chance, tre_bound_mm=None)
    if found.doubtful:
        return Stop.DOUBTFUL, replace(found, tre_bound_mm=None)
    return stop, found
