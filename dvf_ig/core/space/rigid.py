"""Rigid transforms between two named frames, off the hot path (rotations by scipy)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core.arrays import BoolArray, FloatArray, frozen_floats, read_only_arrays
from dvf_ig.core.errors import FrameMismatchError, InvalidInputError

from .frames import check_frame, require_same_frame
from .points import Points

RIGID_TOLERANCE = 1e-3
"""Largest accepted |RᵀR − I| and |det R − 1| of an imported matrix (docs/theory/safety.md)."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Rigid:
    """Rigid transform target_from_source: p_target = rotation @ p_source + translation_mm.

    Attributes:
        target, source: frame names.
        rotation: (3, 3), proper orthonormal.
        translation_mm: (3,) in the target frame.
    """

    target: str
    source: str
    rotation: FloatArray
    translation_mm: FloatArray

    def __post_init__(self) -> None:
        check_frame(self.target)
        check_frame(self.source)
        rotation = frozen_floats(self.rotation, f"rotation of {self.name}", (3, 3))
        defect = rigidity_defect(rotation)
        if defect > 1e-6:
            raise InvalidInputError(
                f"{self.name} is not rigid: |RᵀR − I| or |det R − 1| is {defect:.2g}, needed below 1e-6; "
                "use Rigid.from_matrix for rounded matrices read from a file"
            )
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(
            self, "translation_mm", frozen_floats(self.translation_mm, f"translation of {self.name}", (3,))
        )

    @property
    def name(self) -> str:
        return f"{self.target}_from_{self.source}"

    @property
    def matrix(self) -> FloatArray:
        """Return the (4, 4) homogeneous matrix as a writable copy."""
        out = np.eye(4)
        out[:3, :3] = self.rotation
        out[:3, 3] = self.translation_mm
        return out

    @property
    def angle_rad(self) -> float:
        return float(Rotation.from_matrix(self.rotation).magnitude())

    @classmethod
    def identity(cls, target: str, source: str) -> "Rigid":
        return cls(target, source, np.eye(3), np.zeros(3))

    @classmethod
    def from_matrix(cls, matrix: Any, target: str, source: str) -> "Rigid":
        """Build from a 4×4 of a file: lost digits are restored, shear and scale are refused.

        Raises:
            InvalidInputError: not 4×4, last row not 0 0 0 1, or further than 1e-3 from a rotation.
        """
        m = frozen_floats(matrix, f"matrix of {target}_from_{source}", (4, 4))
        if not np.allclose(m[3], (0, 0, 0, 1), atol=1e-9):
            raise InvalidInputError(f"{target}_from_{source}: last row is {m[3].tolist()}, needed 0 0 0 1")
        defect = rigidity_defect(m[:3, :3])
        if defect > RIGID_TOLERANCE:
            raise InvalidInputError(
                f"{target}_from_{source} is not rigid: |RᵀR − I| or |det R − 1| is {defect:.3g}, "
                f"needed at most {RIGID_TOLERANCE:g}; remove scale and shear or read it as an image map"
            )
        return cls(target, source, nearest_rotation(m[:3, :3]), m[:3, 3])

    @classmethod
    def from_rotation_vector(
        cls, rotation_rad: Any, translation_mm: Any, target: str, source: str
    ) -> "Rigid":
        """Build from a rotation vector (rad, axis times angle) and a translation (mm)."""
        vector = frozen_floats(rotation_rad, "rotation vector", (3,))
        return cls(target, source, Rotation.from_rotvec(vector.copy()).as_matrix(), translation_mm)

    def inverse(self) -> "Rigid":
        """Return source_from_target."""
        return Rigid(self.source, self.target, self.rotation.T, -self.rotation.T @ self.translation_mm)

    def __matmul__(self, other: "Rigid") -> "Rigid":
        if self.source != other.target:
            raise FrameMismatchError(
                f"cannot compose {self.name} @ {other.name}: '{self.source}' does not meet '{other.target}'"
            )
        return Rigid(
            self.target,
            other.source,
            nearest_rotation(self.rotation @ other.rotation),
            self.rotation @ other.translation_mm + self.translation_mm,
        )

    def apply(self, points: Points) -> Points:
        """Map points from the source frame to the target frame."""
        require_same_frame(self.source, points.frame, f"{self.name}.apply")
        return Points(self.target, self.apply_array(points.xyz_mm))

    def apply_array(self, xyz_mm: FloatArray) -> FloatArray:
        """Map (..., 3) source coordinates to target coordinates; the caller answers for the frame."""
        return xyz_mm @ self.rotation.T + self.translation_mm

    def perturbed_left(self, rotation_rad: Any, translation_mm: Any, center_mm: Any) -> "Rigid":
        """Apply a small motion in the target frame: rotate about `center_mm`, then translate.

        Args:
            rotation_rad, translation_mm, center_mm: (3,) each, all in the target frame.
        """
        turn = Rotation.from_rotvec(np.asarray(rotation_rad, dtype=np.float64)).as_matrix()
        center = np.asarray(center_mm, dtype=np.float64)
        shift = turn @ (self.translation_mm - center) + center + np.asarray(translation_mm, dtype=np.float64)
        return Rigid(self.target, self.source, nearest_rotation(turn @ self.rotation), shift)

    def interpolated(self, other: "Rigid", weight: float) -> "Rigid":
        """Interpolate between self (weight 0) and other (weight 1): slerp and linear translation."""
        require_same_frame(self.target, other.target, "interpolation target")
        require_same_frame(self.source, other.source, "interpolation source")
        step = Rotation.from_matrix(self.rotation.T @ other.rotation).as_rotvec() * weight
        return Rigid(
            self.target,
            self.source,
            nearest_rotation(self.rotation @ Rotation.from_rotvec(step).as_matrix()),
            (1 - weight) * self.translation_mm + weight * other.translation_mm,
        )


def rigidity_defect(rotation: FloatArray) -> float:
    """Compute the largest of |RᵀR − I| (entrywise) and |det R − 1| of a (3, 3).

    Written with plain floats, as numpy takes eight times as long.
    """
    return float(max(map(abs, _departures(rotation.tolist()))))


def _departures(rows: Any) -> tuple[Any, ...]:
    """Compute RᵀR − I, its upper half, and det R − 1 of (3, 3, ...) entries, floats or arrays."""
    (a, b, c), (d, e, f), (g, h, i) = rows
    return (
        a * a + d * d + g * g - 1.0,
        b * b + e * e + h * h - 1.0,
        c * c + f * f + i * i - 1.0,
        a * b + d * e + g * h,
        a * c + d * f + g * i,
        b * c + e * f + h * i,
        a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) - 1.0,
    )


def nearest_rotation(matrix: FloatArray) -> FloatArray:
    """Find the proper rotation closest to `matrix` in the Frobenius norm."""
    u, _, vt = np.linalg.svd(matrix)
    if np.linalg.det(u @ vt) < 0.0:
        u[:, 2] *= -1.0
    return np.asarray(u @ vt, dtype=np.float64)


def is_rigid(matrix: FloatArray) -> bool:
    """Return whether a tracker's (4, 4) is finite and rigid to within RIGID_TOLERANCE."""
    return bool(np.isfinite(matrix).all()) and rigidity_defect(matrix[:3, :3]) <= RIGID_TOLERANCE


def are_rigid(matrices: FloatArray) -> BoolArray:
    """Return `is_rigid` of (n, 4, 4), bit for bit."""
    with np.errstate(invalid="ignore", over="ignore"):
        defects = np.abs(_departures(matrices[:, :3, :3].transpose(1, 2, 0))).max(axis=0)
    return np.asarray(np.isfinite(matrices).all(axis=(1, 2)) & (defects <= RIGID_TOLERANCE))
