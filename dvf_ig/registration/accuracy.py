"""Target registration error: the only accuracy of a registration (Fitzpatrick, ch. 8)."""

import numpy as np

from dvf_ig.core import FloatArray, Points, Rigid

from .pose_chart import covariance_to_mm


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
