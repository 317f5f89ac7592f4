"""How the pixels of slices move with the pose: from sums over pixels to LC2's gradient and matrix.

The kernel sums over each slice's pixels, at h = (column, row, 1) and in voxels. With x = P h the place of a
pixel, in mm from the centre of rotation, a small motion ξ (see `PoseChart`) moves the model past it by
Bᵀ(h) ξ, B(h) = (x × ·/ρ, ·): linear in h, so B(h) = Σ_k h_k B_k.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import HEART_RADIUS_MM, FloatArray, IntArray, read_only_arrays
from dvf_ig.kernels.lc2.step import FORCE, MATRIX

_TRIANGLE = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])
"""Where the entries of a symmetric matrix lie in its lower triangle by rows."""
_MATRIX = MATRIX + 6 * _TRIANGLE[:, None, :, None] + _TRIANGLE[None, :, None, :]
"""(3, 3, 3, 3) columns of h_k h_l G_ab among a slice's sums, by k, a, l, b."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SliceMotion:
    """See the module docstring.

    Attributes:
        steps: (s, 3, 3, 6) change of a voxel index, along each axis, with ξ, for each entry of h.
    """

    steps: FloatArray

    @classmethod
    def of(cls, mm_from_pixel: FloatArray, index_from_mm: FloatArray) -> "SliceMotion":
        """From (s, 3, 3) mm from the centre of rotation, target frame; (3, 3) voxel steps of a mm step."""
        steps = np.zeros((len(mm_from_pixel), 3, 3, 6))
        # (P_k × Mᵀf)/ρ, row by row of the voxel axes
        place = mm_from_pixel.transpose(0, 2, 1)[:, :, None, :]
        steps[..., :3] = np.cross(place, index_from_mm) / HEART_RADIUS_MM
        steps[:, 2, :, 3:] = index_from_mm
        return cls(steps)

    def repeated(self, counts: IntArray) -> "SliceMotion":
        """Of parts that move as their slice does: `counts` (s,) of each slice."""
        return SliceMotion(np.repeat(self.steps, counts, axis=0))

    def gradient(self, sums: FloatArray) -> FloatArray:
        """(s, 6) Jᵀr of each slice, from the kernel's (s, STEP_SUMS)."""
        flat = self.steps.reshape(len(self.steps), FORCE, 6)
        return np.asarray((sums[:, None, :FORCE] @ flat)[:, 0])

    def matrix(self, sums: FloatArray) -> FloatArray:
        """(6, 6) JᵀJ of all slices together, from the kernel's (s, STEP_SUMS)."""
        flat = self.steps.reshape(len(self.steps), FORCE, 6)
        products = sums[:, _MATRIX].reshape(len(sums), FORCE, FORCE)
        return np.asarray((flat.transpose(0, 2, 1) @ products @ flat).sum(axis=0))
