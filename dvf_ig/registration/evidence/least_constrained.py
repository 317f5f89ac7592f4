"""The least-constrained direction of a registered pose, and which view would constrain it.

The largest eigenvector of the covariance, in mm at the heart's radius, is a small screw motion; its larger
part, rotation or translation, names it.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, read_only_arrays
from dvf_ig.registration.pose_chart import covariance_to_mm

AXES = ("left–right", "front–back", "head–foot")
"""The axes of LPS."""
NEAR = 0.9
"""Cosine from which a direction is called after an axis."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class LeastConstrained:
    """The least-constrained direction of a pose.

    Attributes:
        sigma_mm: standard deviation along it, at the heart's radius; inf where nothing constrains it.
        turning: whether it is mainly a rotation.
        axis: (3,) unit vector in the target frame (LPS): of the rotation, or of the translation.
        turn_share: share of the variance that is rotation.
    """

    sigma_mm: float
    turning: bool
    axis: FloatArray
    turn_share: float

    def sentence(self) -> str:
        """The direction in words, and which view would help."""
        if not np.isfinite(self.sigma_mm):
            return "the slices leave the pose open; sweep the probe over more of the heart, from other sides"
        x, y, z = self.axis
        k = int(np.abs(self.axis).argmax())
        name = f", {AXES[k]}" if abs(self.axis[k]) >= NEAR else ""
        along = f"({x:.1f}, {y:.1f}, {z:.1f}){name}"
        if self.turning:
            return (
                f"weakest: {self.sigma_mm:.1f} mm by turning about {along}; "
                "add views whose plane lies across that axis"
            )
        return f"weakest: {self.sigma_mm:.1f} mm along {along}; add views whose plane holds that direction"


def least_constrained_direction(covariance: FloatArray) -> LeastConstrained:
    """The direction of the largest variance, in mm at the heart's radius.

    Args:
        covariance: (6, 6) rad², mm²; rotation vector then translation, about the heart box's centre, axes
            LPS. Any value that is not finite says that the pose is not a minimum.
    Raises:
        InvalidInputError: another shape, or a negative variance.
    """
    matrix = np.asarray(covariance, dtype=np.float64)
    if matrix.shape != (6, 6):
        raise InvalidInputError(f"a pose covariance has shape {matrix.shape}; needed (6, 6)")
    if not np.isfinite(matrix).all():
        return LeastConstrained(float("inf"), False, np.zeros(3), 0.0)
    values, vectors = np.linalg.eigh(covariance_to_mm(matrix))
    if values[0] < -1e-9 * max(values[-1], 1e-12):
        raise InvalidInputError(f"a pose covariance has a variance of {values[0]:.3g}; needed none below 0")
    worst = vectors[:, -1]
    turn_share = float(worst[:3] @ worst[:3])
    part = worst[:3] if turn_share > 0.5 else worst[3:]
    axis = part / np.linalg.norm(part)
    axis *= np.sign(axis[np.abs(axis).argmax()])
    return LeastConstrained(float(np.sqrt(values[-1])), turn_share > 0.5, axis, turn_share)
