"""Time-stamped poses of one tracked object."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core.arrays import BoolArray, FloatArray, frozen, frozen_floats, read_only_arrays
from dvf_ig.core.errors import InvalidInputError
from dvf_ig.core.space.frames import check_frame
from dvf_ig.core.space.rigid import Rigid, are_rigid

MAX_GAP_S = 0.25
"""Longest gap between valid samples that is interpolated."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class PoseStream:
    """Pose target_from_source over time.

    Attributes:
        target, source: frame names.
        t_s: (n,) strictly increasing, tracker clock.
        rotations: (n, 3, 3).
        translations_mm: (n, 3).
        valid: (n,) False unless the tracker reported OK; other samples are never used.
    """

    target: str
    source: str
    t_s: FloatArray
    rotations: FloatArray
    translations_mm: FloatArray
    valid: BoolArray

    def __post_init__(self) -> None:
        check_frame(self.target)
        check_frame(self.source)
        t_s = frozen_floats(self.t_s, f"times of {self.name}", (None,))
        if len(t_s) == 0:
            raise InvalidInputError(f"{self.name} has no poses")
        if (np.diff(t_s) <= 0).any():
            raise InvalidInputError(f"times of {self.name} do not increase strictly; drop repeated samples")
        n = len(t_s)
        valid = frozen(self.valid, f"status of {self.name}", (n,), np.bool_)
        rotations = frozen_floats(self.rotations, f"rotations of {self.name}", (n, 3, 3), finite=False)
        translations = frozen_floats(
            self.translations_mm, f"translations of {self.name}", (n, 3), finite=False
        )
        usable = rotations[valid]
        if not (np.isfinite(usable).all() and np.isfinite(translations[valid]).all()):
            raise InvalidInputError(f"{self.name} has non-finite poses whose status is OK")
        if len(usable):
            gram = np.abs(np.einsum("nij,nik->njk", usable, usable) - np.eye(3)).max(axis=(1, 2))
            defect = np.maximum(gram, np.abs(np.linalg.det(usable) - 1))
            if defect.max() > 1e-3:
                worst = int(np.flatnonzero(valid)[int(defect.argmax())])
                raise InvalidInputError(
                    f"{self.name}, sample {worst}: not a rotation (defect {defect.max():.3g}, needed at most "
                    "1e-3); the tracker pose carries scale or shear"
                )
        object.__setattr__(self, "t_s", t_s)
        object.__setattr__(self, "rotations", rotations)
        object.__setattr__(self, "translations_mm", translations)
        object.__setattr__(self, "valid", valid)

    @classmethod
    def of_matrices(
        cls, target: str, source: str, t_s: FloatArray, matrices: Sequence[FloatArray | None]
    ) -> "PoseStream":
        """Build from a tracker's (4, 4) matrices, None if it did not report OK.

        Poses with scale, shear or non-finite entries count as not OK.
        """
        matrices_ok = np.tile(np.eye(4), (len(matrices), 1, 1))
        valid = np.zeros(len(matrices), dtype=np.bool_)
        tracked = [i for i, matrix in enumerate(matrices) if matrix is not None]
        if tracked:
            matrices_ok[tracked] = [matrices[i] for i in tracked]
            valid[tracked] = are_rigid(matrices_ok[tracked])
            matrices_ok[~valid] = np.eye(4)
        return cls(target, source, t_s, matrices_ok[:, :3, :3], matrices_ok[:, :3, 3], valid)

    @property
    def name(self) -> str:
        return f"{self.target}_from_{self.source}"

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def rate_hz(self) -> float:
        """Median sampling rate."""
        return float(1.0 / np.median(np.diff(self.t_s))) if len(self) > 1 else 0.0

    def pose(self, i: int) -> Rigid:
        """Return sample i as it was tracked.

        Raises:
            InvalidInputError: the tracker did not report OK.
        """
        if not self.valid[i]:
            raise InvalidInputError(f"{self.name}, sample {i}: the tracker did not report OK")
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotations[i], self.translations_mm[i]
        return Rigid.from_matrix(matrix, self.target, self.source)

    def at(self, t_s: float) -> Rigid | None:
        """Interpolate the pose at `t_s` by slerp; None if a neighbour is invalid or too far."""
        rotations, translations, valid = self.at_many(np.array([t_s]))
        if not valid[0]:
            return None
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotations[0], translations[0]
        return Rigid.from_matrix(matrix, self.target, self.source)

    def at_many(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Interpolate rotations (k, 3, 3), translations (k, 3) and validity (k,) at the given times.

        A time is valid when both recorded neighbours are, and lie at most MAX_GAP_S apart. Invalid samples
        are never interpolated over; entries that are not valid hold the identity.
        """
        t = np.asarray(t_s, dtype=np.float64)
        right = np.clip(np.searchsorted(self.t_s, t, side="left"), 0, len(self) - 1)
        left = np.where(self.t_s[right] == t, right, np.maximum(right - 1, 0))
        gap = self.t_s[right] - self.t_s[left]
        inside = (t >= self.t_s[left]) & (t <= self.t_s[right])
        ok = inside & self.valid[left] & self.valid[right] & (gap <= MAX_GAP_S)
        rotations = np.tile(np.eye(3), (len(t), 1, 1))
        translations = np.zeros((len(t), 3))
        if ok.any():
            a, b = left[ok], right[ok]
            weight = np.where(gap[ok] > 0, (t[ok] - self.t_s[a]) / np.where(gap[ok] > 0, gap[ok], 1.0), 0.0)
            first = Rotation.from_matrix(self.rotations[a])
            step = (first.inv() * Rotation.from_matrix(self.rotations[b])).as_rotvec()
            rotations[ok] = (first * Rotation.from_rotvec(step * weight[:, None])).as_matrix()
            translations[ok] = (1 - weight)[:, None] * self.translations_mm[a] + weight[
                :, None
            ] * self.translations_mm[b]
        return rotations, translations, ok

    def inverse(self) -> "PoseStream":
        """Return source_from_target with the same times and statuses."""
        turned = np.swapaxes(self.rotations, 1, 2)
        return PoseStream(
            self.source,
            self.target,
            self.t_s,
            turned,
            -np.einsum("nij,nj->ni", turned, self.translations_mm),
            self.valid,
        )

    def __matmul__(self, other: "PoseStream") -> "PoseStream":
        """Compose two streams with the same times, sample by sample."""
        if self.source != other.target:
            raise InvalidInputError(
                f"cannot compose {self.name} @ {other.name}: '{self.source}' does not meet '{other.target}'"
            )
        if not np.array_equal(self.t_s, other.t_s):
            raise InvalidInputError(f"cannot compose {self.name} @ {other.name}: their times differ")
        return PoseStream(
            self.target,
            other.source,
            self.t_s,
            np.einsum("nij,njk->nik", self.rotations, other.rotations),
            np.einsum("nij,nj->ni", self.rotations, other.translations_mm) + self.translations_mm,
            self.valid & other.valid,
        )
