"""Anatomical warp W: a smooth map of space from the standard heart to one person's."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dvf_ig.core import FloatArray, Rigid, read_only_arrays

from .mismatch import SmoothField, TabulatedMap, tabulated

TOLERANCE_MM = 1e-4
STEP_MM = 1e-2
TABLE_MM = 4.0
"""Node pitch of tabulated warps: the interpolation error stays below 0.05 mm."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class AnatomicalWarp:
    """W(p) = c + A (p + Σ v exp(−½ Σ ((p − b)/σ)²) + m(p) − c) in the heart frame, mm.

    The affine part keeps the motion of the wall incompressible; the small rest nearly does.

    Attributes:
        affine: (3, 3) A: size along the axes, tilt and shear.
        center_mm: (3,) c, the fixed point of A.
        bump_center_mm, bump_width_mm, bump_mm: (k, 3) b, σ and v: septum, apex, eccentric cavity.
        field: m, the remaining individual variation.
    """

    affine: FloatArray
    center_mm: FloatArray
    bump_center_mm: FloatArray
    bump_width_mm: FloatArray
    bump_mm: FloatArray
    field: SmoothField

    def forward(self, points: FloatArray) -> FloatArray:
        """Map (n, 3) points of the standard heart to the person's."""
        return np.asarray(self.center_mm + (points + self._local(points) - self.center_mm) @ self.affine.T)

    def inverse(self, points: FloatArray) -> FloatArray:
        """Map (n, 3) points back to the standard heart, by fixed-point iteration to TOLERANCE_MM."""
        moved = self.center_mm + (points - self.center_mm) @ np.linalg.inv(self.affine).T
        out = np.array(moved)
        going = np.arange(len(out))
        for _ in range(80):
            correction = moved[going] - out[going] - self._local(out[going])
            out[going] += correction
            going = going[np.abs(correction).max(axis=1) > TOLERANCE_MM]
            if not len(going):
                break
        return out

    def determinant(self, points: FloatArray) -> FloatArray:
        """Compute (n,) det ∇W at (n, 3) points of the standard heart."""
        columns = [
            (self.forward(points + step) - self.forward(points - step)) / (2 * STEP_MM)
            for step in STEP_MM * np.eye(3)
        ]
        return np.asarray(np.linalg.det(np.stack(columns, axis=-1)))

    def _local(self, points: FloatArray) -> FloatArray:
        out = self.field.at(points)
        for center, width, bump in zip(self.bump_center_mm, self.bump_width_mm, self.bump_mm, strict=True):
            share = np.exp(-0.5 * (((points - center) / width) ** 2).sum(axis=-1))
            out = out + share[:, None] * bump
        return np.asarray(out)


@read_only_arrays
@dataclass(frozen=True, eq=False)
class PlacedWarp:
    """Warp W about a heart in frame "mr": exact, and tabulated for imaging.

    Attributes:
        warp: W in the heart frame.
        mr_from_heart: pose of the heart.
        box_mm: (2, 3) box of the standard heart in frame "mr", covered by the table.
    """

    warp: AnatomicalWarp
    mr_from_heart: Rigid
    box_mm: FloatArray

    @cached_property
    def table(self) -> TabulatedMap:
        return tabulated(self.forward, self.box_mm, TABLE_MM)

    def forward(self, xyz_mm: FloatArray) -> FloatArray:
        """Map (n, 3) points of the standard heart to the person's."""
        return self.mr_from_heart.apply_array(self.warp.forward(self.local(xyz_mm)))

    def inverse(self, xyz_mm: FloatArray) -> FloatArray:
        """Map (n, 3) positions in the person's heart to the standard heart."""
        return self.mr_from_heart.apply_array(self.warp.inverse(self.local(xyz_mm)))

    def local(self, xyz_mm: FloatArray) -> FloatArray:
        """Map (n, 3) points to the heart frame."""
        return np.asarray((xyz_mm - self.mr_from_heart.translation_mm) @ self.mr_from_heart.rotation)
