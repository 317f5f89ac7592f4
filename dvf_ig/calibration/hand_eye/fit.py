"""The chain base ← hand ← camera ← target of a hand–eye calibration: its residuals and its fit."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from dvf_ig.core import FloatArray, read_only_arrays


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """Paired poses: base_from_hand and camera_from_target, (n, 3, 3) and (n, 3) mm each."""

    hand_rotations: FloatArray
    hand_translations: FloatArray
    target_rotations: FloatArray
    target_translations: FloatArray

    def __len__(self) -> int:
        return len(self.hand_rotations)

    def part(self, keep: Any) -> "Chain":
        """Select pairs by a mask or by indices."""
        return Chain(
            self.hand_rotations[keep],
            self.hand_translations[keep],
            self.target_rotations[keep],
            self.target_translations[keep],
        )

    def axis_spread(self) -> float:
        """Ratio of second to first principal size of the hand's rotation vectors between pairs of poses."""
        first, second = np.triu_indices(len(self), 1)
        step = max(1, len(first) // 2000)
        first, second = first[::step], second[::step]
        between = np.einsum("nji,njk->nik", self.hand_rotations[first], self.hand_rotations[second])
        sizes = np.linalg.svd(Rotation.from_matrix(between).as_rotvec(), compute_uv=False)
        return float(sizes[1] / sizes[0]) if len(sizes) > 1 and sizes[0] > 0 else 0.0

    def targets(self, hand_from_camera: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute base_from_target through each pair: (n, 3, 3) and (n, 3) mm."""
        to_hand = hand_from_camera[:3, :3] @ self.target_rotations
        in_hand = self.target_translations @ hand_from_camera[:3, :3].T + hand_from_camera[:3, 3]
        moved = np.einsum("nij,nj->ni", self.hand_rotations, in_hand) + self.hand_translations
        return self.hand_rotations @ to_hand, moved

    def middle_target(self, hand_from_camera: FloatArray) -> FloatArray:
        """Return base_from_target (4, 4) of the pair whose target is nearest to all others."""
        rotations, translations = self.targets(hand_from_camera)
        center = np.median(translations, axis=0)
        away = np.linalg.norm(translations - center, axis=1)
        near = away <= np.median(away)
        out = np.eye(4)
        out[:3, :3] = Rotation.from_matrix(rotations[near]).mean().as_matrix()
        out[:3, 3] = center
        return out

    def residuals(
        self, hand_from_camera: FloatArray, base_from_target: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(n,) distance, mm, and angle, degrees, of each pair's target from base_from_target."""
        rotation, shift = self.errors(hand_from_camera, base_from_target)
        return np.linalg.norm(shift, axis=1), np.degrees(np.linalg.norm(rotation, axis=1))

    def errors(
        self, hand_from_camera: FloatArray, base_from_target: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(n, 3) rotation vectors, rad, and (n, 3) shifts, mm, of each pair's target, in its axes."""
        rotations, translations = self.targets(hand_from_camera)
        rotation = base_from_target[:3, :3].T @ rotations
        shift = (translations - base_from_target[:3, 3]) @ base_from_target[:3, :3]
        return Rotation.from_matrix(rotation).as_rotvec(), shift


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ChainFit:
    """(4, 4) hand_from_camera and base_from_target, and the (6, 6) covariance of the first (rad², mm²)."""

    hand_from_camera: FloatArray
    base_from_target: FloatArray
    covariance: FloatArray


def refine(chain: Chain, hand_from_camera: FloatArray) -> ChainFit:
    """Refine both unknown maps together by least squares on angles and shifts, each over its own spread.

    Source: Strobl & Hirzinger 2006 (the weight between rotation and translation from their residuals).
    """
    camera, target = hand_from_camera, chain.middle_target(hand_from_camera)
    for _ in range(2):
        errors = chain.errors(camera, target)
        scales = [max(float(np.sqrt((error**2).mean())), 1e-9) for error in errors]
        solved = least_squares(_stacked, np.zeros(12), args=(chain, camera, target, scales), x_scale="jac")
        camera, target = _moved(camera, solved.x[:6]), _moved(target, solved.x[6:])
    freedom = max(1, solved.fun.size - 12)
    slope = np.asarray(solved.jac, dtype=np.float64)
    inverse = np.linalg.pinv(slope.T @ slope)
    return ChainFit(camera, target, np.asarray(inverse[:6, :6] * (solved.fun @ solved.fun) / freedom))


def _stacked(
    step: FloatArray, chain: Chain, camera: FloatArray, target: FloatArray, scales: list[float]
) -> FloatArray:
    rotation, shift = chain.errors(_moved(camera, step[:6]), _moved(target, step[6:]))
    return np.concatenate([rotation.ravel() / scales[0], shift.ravel() / scales[1]])


def _moved(matrix: FloatArray, step: FloatArray) -> FloatArray:
    """(4, 4) after a rotation vector (rad) on the left of its rotation and a shift (mm)."""
    out = matrix.copy()
    out[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix() @ matrix[:3, :3]
    out[:3, 3] = matrix[:3, 3] + step[3:]
    return out
