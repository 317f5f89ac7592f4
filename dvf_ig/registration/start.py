"""A coarse start from anatomical points touched on the patient and marked on the model."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, Landmarks, Points, Rigid, read_only_arrays
from dvf_ig.core.space.paired import fit_paired_points

from .pose_chart import rigid_motion

MIN_FOR_PRIOR = 5
"""Fewer pairs of landmarks leave too few residuals to know how far off the points are."""
LEAST_SIGMA_MM = 0.5
"""A stylus on a beating heart is never better than this per coordinate."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkStart:
    """mr_from_tracker from paired landmarks, with the residual of each in mm (FRE, not an accuracy)."""

    mr_from_tracker: Rigid
    names: tuple[str, ...]
    residuals_mm: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkPrior:
    """Touched landmarks as a likelihood of the pose beside the image: paired points and their spread.

    Attributes:
        target: (n, 3) marked on the model.
        source: (n, 3) touched on the patient.
        sigma_mm: standard deviation of a touched point per coordinate.
    """

    target: Points
    source: Points
    sigma_mm: float

    def energy(self, pose: Rigid) -> float:
        """Half the squared distance of the landmarks in standard deviations: −log of their likelihood."""
        apart = pose.apply(self.source).xyz_mm - self.target.xyz_mm
        return float(0.5 * (apart * apart).sum() / self.sigma_mm**2)

    def normal_equations(self, pose: Rigid, center_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(6, 6) and (6,): curvature and downhill direction of `energy` in the coordinates of `PoseChart`."""
        at = pose.apply(self.source).xyz_mm
        flat = rigid_motion(at, center_mm).reshape(-1, 6) / self.sigma_mm
        return flat.T @ flat, flat.T @ (self.target.xyz_mm - at).ravel() / self.sigma_mm


def prior_from_landmarks(mr: Landmarks, tracker: Landmarks) -> LandmarkPrior | None:
    """Prior from the landmarks that both sets name, its sigma from their own residuals.

    None with fewer than MIN_FOR_PRIOR pairs: too few residuals to know how far off the points are.
    """
    _, target, source = mr.paired_with(tracker)
    if len(target) < MIN_FOR_PRIOR:
        return None
    residuals = start_from_landmarks(mr, tracker).residuals_mm
    spread = float(np.sqrt((residuals**2).sum() / (3 * len(target) - 6)))
    return LandmarkPrior(target, source, max(spread, LEAST_SIGMA_MM))


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
            "needed at least 3: name the same points alike in both files"
        )
    pose = fit_paired_points(target, source)
    residuals = np.linalg.norm(pose.apply(source).xyz_mm - target.xyz_mm, axis=1)
    return LandmarkStart(pose, names, residuals)
