"""A rigid pose as six numbers in one unit, and errors and distances between poses.

ξ = (rotation vector · radius, translation), all in mm at the heart's radius: a left perturbation of a pose
about the centre of the heart box in the target frame. The target registration error is the only accuracy of a
registration (Fitzpatrick, ch. 8).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from dvf_ig.core import (
    HEART_RADIUS_MM,
    FloatArray,
    Points,
    Rigid,
    mean_displacement_mm,
    read_only_arrays,
    require_same_frame,
)

LARGEST_PER_QUANTILE = 1.08
"""95 % quantile of the largest error over a surface, as a multiple of the largest of its points' 95 %
quantiles: 1.04 to 1.15 in draws from the covariances of eight sweeps against short-axis stacks."""
DISTINCT_MM = 4.0
"""Poses nearer to each other than this, mean over the heart, count as one."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PoseChart:
    """Six coordinates about a pose; see the module docstring.

    Attributes:
        base: target_from_source.
        center_mm: (3,) about which poses turn, target frame.
    """

    base: Rigid
    center_mm: FloatArray

    def pose(self, xi_mm: FloatArray) -> Rigid:
        return self.base.perturbed_left(xi_mm[:3] / HEART_RADIUS_MM, xi_mm[3:], self.center_mm)

    def coordinates(self, pose: Rigid) -> FloatArray:
        """(6,) ξ of a pose between the same frames: the inverse of `pose`."""
        require_same_frame(self.base.target, pose.target, "coordinates")
        require_same_frame(self.base.source, pose.source, "coordinates")
        rotation = pose.rotation @ self.base.rotation.T
        turn = HEART_RADIUS_MM * Rotation.from_matrix(rotation).as_rotvec()
        at_center = rotation @ (self.center_mm - self.base.translation_mm) + pose.translation_mm
        return np.concatenate([turn, at_center - self.center_mm])


def distinct(poses: Sequence[Rigid], center_mm: FloatArray) -> list[int]:
    """Numbers of the poses that lie DISTINCT_MM or more from every chosen one before them, in order.

    Args:
        poses: best first.
    """
    chosen: list[int] = []
    for k, pose in enumerate(poses):
        if all(mean_displacement_mm(pose, poses[other], center_mm) > DISTINCT_MM for other in chosen):
            chosen.append(k)
    return chosen


def random_displacements(rng: np.random.Generator, count: int, length_mm: float) -> FloatArray:
    """(count, 6) ξ of one length in random directions."""
    directions = rng.normal(size=(count, 6))
    directions *= length_mm / np.linalg.norm(directions, axis=1, keepdims=True)
    return directions


def rigid_motion(places_mm: FloatArray, center_mm: FloatArray) -> FloatArray:
    """(n, 3, 6) motion of (n, 3) places with ξ, to first order."""
    out = np.zeros((len(places_mm), 3, 6))
    for k, axis in enumerate(np.eye(3)):
        out[:, :, k] = np.cross(axis, places_mm - center_mm) / HEART_RADIUS_MM
        out[:, k, 3 + k] = 1.0
    return out


def covariance_to_mm(covariance: FloatArray) -> FloatArray:
    """(6, 6) of ξ in mm², from rotation vector and translation in rad², mm²."""
    unit = np.diag([HEART_RADIUS_MM] * 3 + [1.0] * 3)
    return np.asarray(unit @ covariance @ unit)


def covariance_from_mm(covariance_mm2: FloatArray) -> FloatArray:
    """(6, 6) of rotation vector and translation in rad², mm², from that of ξ: the inverse of the above."""
    unit = np.diag([1 / HEART_RADIUS_MM] * 3 + [1.0] * 3)
    return np.asarray(unit @ covariance_mm2 @ unit)


def target_errors_mm(estimate: Rigid, truth: Rigid, targets: Points) -> FloatArray:
    """(n,) distance at each target between the estimated and the true map.

    Args:
        estimate, truth: target_from_source, same frames.
        targets: points in the *target* frame ("mr"), where the declared anatomy lies.
    """
    source = truth.inverse().apply(targets)
    return np.asarray(np.linalg.norm(estimate.apply(source).xyz_mm - targets.xyz_mm, axis=1))


def pose_difference(estimate: Rigid, truth: Rigid, center_mm: FloatArray) -> tuple[float, FloatArray]:
    """Rotation angle in degrees, and translation (3,) in mm at `center_mm` (target frame)."""
    step = estimate @ truth.inverse()
    shift = step.rotation @ center_mm + step.translation_mm - center_mm
    return float(np.degrees(step.angle_rad)), shift


def predicted_error_mm(covariance: FloatArray) -> float:
    """RMS target error over a sphere of the heart's radius that a covariance (rad², mm²) predicts.

    Of a unit turn about a random axis a point of the sphere moves by two thirds of its squared radius.
    """
    variance = np.diag(covariance_to_mm(covariance))
    return float(np.sqrt(2.0 / 3.0 * variance[:3].sum() + variance[3:].sum()))


def largest_error_bound_mm(covariance: FloatArray, targets_mm: FloatArray, center_mm: FloatArray) -> float:
    """Bound the largest error over (n, 3) targets with 95 % by a covariance (rad², mm²); NaN if that is.

    Args:
        center_mm: (3,) about which the pose turns.

    Source: Satterthwaite 1946 (a quadratic form as a scaled χ² of the same mean and variance).
    """
    motion = rigid_motion(targets_mm, center_mm)
    spread = motion @ covariance_to_mm(covariance) @ motion.transpose(0, 2, 1)
    mean = np.trace(spread, axis1=1, axis2=2)
    square = np.einsum("nij,nij->n", spread, spread)
    quantile = np.sqrt(square / mean * chi2.ppf(0.95, mean * mean / square))
    return LARGEST_PER_QUANTILE * float(quantile.max())
