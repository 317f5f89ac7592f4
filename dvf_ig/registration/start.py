"""Landmarks touched on the patient and marked on the model: a start, a prior, and checks of their axes.

Coordinates in RAS taken for LPS, or the reverse, turn by 180° about the long axis of the body: no check of
rigidity can see it, and a fit to landmarks absorbs it. The model, which the marked points lie on, and a pose
given in addition to the landmarks reveal it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import (
    RAS_FROM_LPS,
    DvfModel,
    FloatArray,
    InvalidInputError,
    Landmarks,
    Points,
    Rigid,
    Warp,
    read_only_arrays,
)
from dvf_ig.core.space.paired import fit_paired_points

from .pose_chart import rigid_motion

MIN_FOR_PRIOR = 5
"""Fewer pairs of landmarks leave too few residuals to know how far off the points are."""
LEAST_SIGMA_MM = 0.5
"""A stylus on a beating heart is never better than this per coordinate."""
LANDMARKS_MM = 4.0
"""Mean distance over the heart from the landmarks' pose that rules out a registration. Landmark fits of
tuning seeds 101–106 lie 0.9 to 1.4 mm from the truth, good poses 2 mm."""
POINT_MM = 5.0
"""Median distance of marked points from the model's surfaces that needs no explanation. Points marked with
2 mm of scatter lie 1.5 to 2.4 mm from it, flipped ones of a heart on the flip's axis 6 to 15 mm (hearts 101
to 112)."""
POSE_MM = 20.0
"""Median distance of landmarks under a coarse start that needs no explanation: starts are 10 mm and 8° off
as a rule."""
FALLS_TO = 0.5
"""A flip that takes the error to less than this share explains it (docs/theory/safety.md)."""
FLIP = np.diag(RAS_FROM_LPS)[:3].copy()
_REPAIR = "the file holds RAS where it says LPS, or the reverse; write it again"


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkStart:
    """mr_from_tracker from paired landmarks, with the residual of each in mm (FRE, not an accuracy)."""

    mr_from_tracker: Rigid
    names: tuple[str, ...]
    residuals_mm: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkPrior:
    """Touched landmarks as a likelihood of the pose in addition to the image: paired points and their spread.

    Attributes:
        target: (n, 3) marked on the model.
        source: (n, 3) touched on the patient.
        sigma_mm: standard deviation of a touched point per coordinate.
        in_search: whether the pose must agree with them; else they only test the probe's calibration.
    """

    target: Points
    source: Points
    sigma_mm: float
    in_search: bool = True

    def energy(self, pose: Rigid) -> float:
        """Half the squared distance of the landmarks in standard deviations: −log of their likelihood."""
        apart = pose.apply(self.source).xyz_mm - self.target.xyz_mm
        return float(0.5 * (apart * apart).sum() / self.sigma_mm**2)

    def normal_equations(self, pose: Rigid, center_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(6, 6) and (6,): curvature and downhill direction of `energy` in the coordinates of `PoseChart`."""
        at = pose.apply(self.source).xyz_mm
        flat = rigid_motion(at, center_mm).reshape(-1, 6) / self.sigma_mm
        return flat.T @ flat, flat.T @ (self.target.xyz_mm - at).ravel() / self.sigma_mm


def prior_from_landmarks(
    mr: Landmarks, tracker: Landmarks, *, in_search: bool = True
) -> LandmarkPrior | None:
    """Prior from the landmarks that both sets name, its sigma from their own residuals.

    None with fewer than MIN_FOR_PRIOR pairs: too few residuals to know how far off the points are.
    """
    _, target, source = mr.paired_with(tracker)
    if len(target) < MIN_FOR_PRIOR:
        return None
    residuals = start_from_landmarks(mr, tracker).residuals_mm
    spread = float(np.sqrt((residuals**2).sum() / (3 * len(target) - 6)))
    return LandmarkPrior(target, source, max(spread, LEAST_SIGMA_MM), in_search)


def start_from_landmarks(mr: Landmarks, tracker: Landmarks) -> LandmarkStart:
    """Least-squares rigid fit of the landmarks that both sets name.

    Raises:
        InvalidInputError: fewer than three common names, or all on one line.
    Source: Arun 1987; see `core.paired`.
    """
    names, target, source = mr.paired_with(tracker)
    if len(names) < 3:
        raise InvalidInputError(
            f"model and patient share {len(names)} landmark names ({', '.join(names) or 'none'}); "
            "needed at least 3: give the same points the same names in both files"
        )
    pose = fit_paired_points(target, source)
    residuals = np.linalg.norm(pose.apply(source).xyz_mm - target.xyz_mm, axis=1)
    return LandmarkStart(pose, names, residuals)


LandmarkFit = Callable[[Warp | None], Rigid]
"""`pose_through` of some landmarks."""


def pose_through(mr: Landmarks, tracker: Landmarks, warp: Warp | None) -> Rigid:
    """Fit mr_from_tracker to landmarks where a change of the heart's shape has taken them; None: none has.

    Raises:
        InvalidInputError: as `start_from_landmarks`.
    """
    if warp is not None:
        mr = Landmarks(mr.names, Points(mr.points.frame, warp.patient_places(mr.points.xyz_mm)))
    return start_from_landmarks(mr, tracker).mr_from_tracker


def landmarks_disagree(apart_mm: float | None) -> bool:
    """Whether touched landmarks rule out a pose.

    Args:
        apart_mm: mean distance over the heart between it and theirs; None without landmarks.
    """
    return apart_mm is not None and apart_mm > LANDMARKS_MM


def require_on_model(marked: Landmarks, model: DvfModel) -> None:
    """Raise InvalidInputError where flipped landmarks lie much nearer the model's surfaces than as given.

    Args:
        marked: on the model at end-diastole, its frame.
    """
    ed = model.ed_phase
    meshes = [model.reference[ed], *(chamber.surfaces[ed] for chamber in model.chambers)]
    surface = np.concatenate([mesh.vertices_mm for mesh in meshes])
    given_mm = _off_mm(marked.points.xyz_mm, surface)
    if given_mm <= POINT_MM:
        return
    flipped_mm = _off_mm(FLIP * marked.points.xyz_mm, surface)
    if flipped_mm < FALLS_TO * given_mm:
        raise InvalidInputError(
            f"the landmarks marked on the model lie {given_mm:.0f} mm from it, and {flipped_mm:.0f} mm with "
            f"x and y reversed: {_REPAIR}"
        )


def require_unflipped(pose: Rigid, marked: Landmarks, touched: Landmarks) -> None:
    """Raise InvalidInputError where landmarks agree with a flipped pose much better than with the given one.

    Args:
        pose: that was given, from the frame of `touched` to that of `marked`.
    """
    _, there, here = marked.paired_with(touched)
    if len(there) < 3:
        return

    def off_mm(before: FloatArray, after: FloatArray) -> float:
        at = after * pose.apply_array(before * here.xyz_mm)
        return float(np.median(np.linalg.norm(at - there.xyz_mm, axis=1)))

    same = np.ones(3)
    given_mm = off_mm(same, same)
    flipped_mm = min(off_mm(FLIP, same), off_mm(same, FLIP), off_mm(FLIP, FLIP))
    if given_mm > POSE_MM and flipped_mm < FALLS_TO * given_mm:
        raise InvalidInputError(
            f"the start pose puts the touched landmarks {given_mm:.0f} mm from where they are marked, and "
            f"{flipped_mm:.0f} mm with x and y reversed: {_REPAIR}"
        )


def _off_mm(points_mm: FloatArray, surface_mm: FloatArray) -> float:
    apart = np.linalg.norm(points_mm[:, None] - surface_mm[None], axis=2)
    return float(np.median(apart.min(axis=1)))
