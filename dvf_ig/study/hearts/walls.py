"""Errors of a registered heart's walls along their normals, where images show them and where they do not.

A wall is seen within SEEN_MM of a point that was found on the boundary between blood and wall, and that truly
lies there; unseen beyond UNSEEN_MM of any. The oracle matches each of these points to its own place in the
pre-operative heart, and fits a rigid pose, or with it the modes of `registration.shape`, to the matches.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from data_synth.heart.beating_anatomy import BeatingAnatomy
from data_synth.heart.motion import HeartMotion
from data_synth.heart.tissue import BLOOD, FIRST_OUTSIDE
from dvf_ig.core import FloatArray, Rigid, ScenarioTruth, SurfaceSeries, nearest_phase
from dvf_ig.kernels.warp import LARGEST_MM2
from dvf_ig.registration import RegistrationResult
from dvf_ig.registration.boundary.points import BoundaryPoints
from dvf_ig.registration.pose_chart import rigid_motion
from dvf_ig.registration.shape.estimate import MODES, modes_of
from dvf_ig.replay.result.pose import wall_errors_mm
from dvf_ig.session import Heart

SEEN_MM, UNSEEN_MM = 15.0, 25.0
PHASES = (0.0, 0.35, 0.7)
VERTICES_APART = 5
PLACES = 200
POINT_PHASES = 50
"""Phases at which the tissue about boundary points is looked up."""
BESIDE_MM = 2.5
"""How far from a boundary point, along its normal, blood must lie on one side and a wall on the other."""
ORACLE_RIDGE = 0.1
"""Weight of the modes' coefficients against one true match: noise of 0.3 mm, changes of 3 mm, ten neighbours
as one."""


@dataclass(frozen=True, slots=True)
class WallErrors:
    """RMS errors of the epicardium along its normals, mm, over PHASES.

    Attributes:
        followed: whether fixtures follow a change of shape; else they stay at the rigid pose.
        seen_rigid_mm, unseen_rigid_mm: by the pose without a change of shape.
        seen_mm, unseen_mm: as fixtures are guided.
        seen_systole_mm: of seen_mm, at the second of PHASES.
        seen_per_sigma, unseen_per_sigma: of errors over their standard deviations; None unless followed.
        known_mm: over the walls where a force may be given, of which seen_known_share is of the seen ones.
        oracle_rigid_mm, oracle_mm: of the seen walls with true matches: a rigid pose, and modes.
        outward_mm, sigma_mm: how far the wall truly lies beyond where it is guarded, and its standard
            deviation, at up to PLACES places where a force may be given.
    """

    followed: bool
    seen_rigid_mm: float
    unseen_rigid_mm: float
    seen_mm: float
    unseen_mm: float
    seen_systole_mm: float
    seen_per_sigma: float | None
    unseen_per_sigma: float | None
    known_mm: float
    seen_known_share: float
    oracle_rigid_mm: float
    oracle_mm: float
    outward_mm: list[float]
    sigma_mm: list[float]


def measure_walls(
    heart: Heart,
    result: RegistrationResult,
    boundary: BoundaryPoints,
    truth: ScenarioTruth,
    before: HeartMotion,
    patient: BeatingAnatomy,
) -> WallErrors:
    """Measure where a registration puts the patient's walls.

    Args:
        boundary: points that were found in the registered images.
        before: motion of the heart in the pre-operative images.
    """
    true_pose = truth.mr_from_tracker_at(0.0)
    places, phases = _surface_at(truth.surface)
    at_mm, matched_mm = _true_matches(boundary, true_pose, before, patient)
    away_mm = cKDTree(at_mm).query(places)[0]
    seen, unseen = away_mm < SEEN_MM, away_mm > UNSEEN_MM
    systole = seen & (phases == phases[len(places) // 2])
    moved = result.target_from_source @ true_pose.inverse()
    followed = None if result.shape is None else result.shape.followed
    rigid_mm, _ = wall_errors_mm(heart.model, moved.apply_array(places), phases, None)
    error_mm, variance_mm2 = wall_errors_mm(heart.model, moved.apply_array(places), phases, followed)
    certain = variance_mm2 <= LARGEST_MM2
    sigma_mm = np.sqrt(variance_mm2)
    per_sigma = error_mm / sigma_mm
    served = np.flatnonzero(certain & np.isfinite(error_mm))
    some = served[:: max(1, -(-len(served) // PLACES))]
    oracles = [_oracle_mm(heart, at_mm, matched_mm, places, phases, count) for count in (0, MODES)]
    return WallErrors(
        followed=followed is not None,
        seen_rigid_mm=_rms(rigid_mm[seen]),
        unseen_rigid_mm=_rms(rigid_mm[unseen]),
        seen_mm=_rms(error_mm[seen]),
        unseen_mm=_rms(error_mm[unseen]),
        seen_systole_mm=_rms(error_mm[systole]),
        seen_per_sigma=None if followed is None else _rms(per_sigma[seen]),
        unseen_per_sigma=None if followed is None else _rms(per_sigma[unseen]),
        known_mm=_rms(error_mm[certain]),
        seen_known_share=float(certain[seen].mean()),
        oracle_rigid_mm=_rms(oracles[0][seen]),
        oracle_mm=_rms(oracles[1][seen]),
        outward_mm=(-error_mm[some]).round(3).tolist(),
        sigma_mm=sigma_mm[some].round(3).tolist(),
    )


def _surface_at(surface: SurfaceSeries) -> tuple[FloatArray, FloatArray]:
    """(n, 3) vertices of the epicardium at PHASES, and (n,) their phase."""
    numbers = nearest_phase(surface.timing.fractions, np.array(PHASES))
    vertices = surface.vertices_mm[numbers, ::VERTICES_APART]
    phases = np.repeat(surface.timing.fractions[numbers], vertices.shape[1])
    return vertices.reshape(-1, 3), phases


def _true_matches(
    boundary: BoundaryPoints, true_pose: Rigid, before: HeartMotion, patient: BeatingAnatomy
) -> tuple[FloatArray, FloatArray]:
    """(n, 3) boundary points that truly lie between blood and wall, and (n, 3) their places in the MR."""
    places = true_pose.apply_array(boundary.points_mm)
    beside = BESIDE_MM * boundary.normals @ true_pose.rotation.T
    number = np.round(boundary.model_phase * POINT_PHASES).astype(int) % POINT_PHASES
    true, matched = np.zeros(len(places), dtype=np.bool_), np.empty_like(places)
    for k in np.unique(number).tolist():
        here, phase = number == k, k / POINT_PHASES
        blood, wall = (patient.tissue((places + side * beside)[here], phase) for side in (-1.0, 1.0))
        true[here] = np.isin(blood, BLOOD) & ~np.isin(wall, BLOOD) & (wall < FIRST_OUTSIDE)
        matched[here] = before.push_forward(patient.material(places[here], phase), phase)
    return places[true], matched[true]


def _oracle_mm(
    heart: Heart,
    at_mm: FloatArray,
    matched_mm: FloatArray,
    places: FloatArray,
    phases: FloatArray,
    count: int,
) -> FloatArray:
    """(n,) errors at places and phases of the pull-back that fits true matches best, by `count` modes."""
    if heart.surface is None:
        raise TypeError("a phantom's MR shows the boundary of blood")
    modes = modes_of(heart.surface, tuple(heart.center_mm.tolist()))

    def columns(points: FloatArray) -> FloatArray:
        moved = [rigid_motion(points, modes.center_mm), modes.at(points, MODES)[:, :, :count]]
        return np.concatenate(moved, axis=2)

    of_points = columns(at_mm).reshape(-1, 6 + count)
    ridge = np.diag(np.repeat([0.0, ORACLE_RIDGE], [6, count]))
    pulled = np.linalg.solve(of_points.T @ of_points + ridge, of_points.T @ (at_mm - matched_mm).ravel())
    return wall_errors_mm(heart.model, places - columns(places) @ pulled, phases, None)[0]


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else np.nan
