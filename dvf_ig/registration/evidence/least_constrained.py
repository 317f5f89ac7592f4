"""In which direction a registration is known worst, and which view would help: its covariance in words.

The largest eigenvector of the covariance, in mm at the heart's radius, is a small screw motion; its larger
part, turn or shift, names it.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, read_only_arrays
from dvf_ig.registration.pose_chart import HEART_RADIUS_MM

AXES = ("left–right", "front–back", "head–foot")
"""The axes of LPS."""
NEAR = 0.9
"""Cosine from which a direction is called after an axis."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Weakness:
    """The worst known direction of a pose.

    Attributes:
        sigma_mm: standard deviation along it, at the heart's radius; inf where the slices leave it open.
        turning: whether it is mainly a turn.
        axis: (3,) unit vector in the fixed frame (LPS): of the turn, or of the shift.
        turn_share: part of the variance that turning has.
    """

    sigma_mm: float
    turning: bool
    axis: FloatArray
    turn_share: float

    def sentence(self) -> str:
        """What is weak and which view would help."""
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


def weak_direction(covariance: FloatArray) -> Weakness:
    """The worst known direction.

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
        return Weakness(float("inf"), False, np.zeros(3), 0.0)
    unit = np.diag([HEART_RADIUS_MM] * 3 + [1.0] * 3)
    values, vectors = np.linalg.eigh(unit @ matrix @ unit)
    if values[0] < -1e-9 * max(values[-1], 1e-12):
        raise InvalidInputError(f"a pose covariance has a variance of {values[0]:.3g}; needed none below 0")
    worst = vectors[:, -1]
    turn_share = float(worst[:3] @ worst[:3])
    part = worst[:3] if turn_share > 0.5 else worst[3:]
    axis = part / np.linalg.norm(part)
    axis *= np.sign(axis[np.abs(axis).argmax()])
    return Weakness(float(np.sqrt(values[-1])), turn_share > 0.5, axis, turn_share)
