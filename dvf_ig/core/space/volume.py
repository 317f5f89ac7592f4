"""Images on a regular grid, in mm, LPS.

Arrays are indexed [i, j, k] = [x, y, z]: the first axis runs along the first column of `direction`.
"""

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from dvf_ig.core.arrays import AnyArray, BoolArray, FloatArray, IntArray, frozen_floats, read_only_arrays
from dvf_ig.core.errors import InvalidInputError
from dvf_ig.core.timing.cycle import CycleTiming

from .frames import check_frame
from .rigid import rigidity_defect


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Geometry of an image's voxels.

    Attributes:
        frame: frame name.
        shape: voxels along each axis.
        origin_mm: (3,) centre of voxel (0, 0, 0).
        spacing_mm: (3,) voxel pitch.
        direction: (3, 3) proper rotation; column a is the direction of axis a.
    """

    frame: str
    shape: tuple[int, int, int]
    origin_mm: FloatArray
    spacing_mm: FloatArray
    direction: FloatArray

    def __post_init__(self) -> None:
        check_frame(self.frame)
        if len(self.shape) != 3 or min(self.shape) < 1:
            raise InvalidInputError(f"grid shape is {self.shape}; needed three positive numbers")
        spacing = frozen_floats(self.spacing_mm, "voxel spacing", (3,))
        if (spacing <= 0).any():
            raise InvalidInputError(f"voxel spacing is {spacing.tolist()} mm; all must be positive")
        direction = frozen_floats(self.direction, "direction matrix", (3, 3))
        defect = rigidity_defect(direction)
        if defect > 1e-3:
            raise InvalidInputError(
                f"the image's direction matrix is not a rotation (defect {defect:.3g}); "
                "resample it onto an orthogonal grid first"
            )
        object.__setattr__(self, "origin_mm", frozen_floats(self.origin_mm, "grid origin", (3,)))
        object.__setattr__(self, "spacing_mm", spacing)
        object.__setattr__(self, "direction", direction)

    @property
    def axes_mm(self) -> FloatArray:
        """Step (3, 3), mm per voxel: column a is one step along axis a."""
        return self.direction * self.spacing_mm

    def to_mm(self, index: FloatArray) -> FloatArray:
        """Convert (..., 3) voxel indices to (..., 3) mm."""
        return np.asarray(index @ self.axes_mm.T + self.origin_mm)

    def to_index(self, xyz_mm: FloatArray) -> FloatArray:
        """Convert (..., 3) mm to (..., 3) continuous voxel indices."""
        return np.asarray((xyz_mm - self.origin_mm) @ np.linalg.inv(self.axes_mm).T)

    def holds(self, index: FloatArray, margin: float = 0.0) -> BoolArray:
        """Return whether voxel indices (..., 3) are within the centres of the outermost voxels.

        Args:
            margin: width added outside, voxels; 0.5 reaches their faces.
        """
        last = np.array(self.shape) - 1.0
        return np.asarray(((index >= -margin) & (index <= last + margin)).all(axis=-1))

    def nearest(self, index: FloatArray) -> tuple[IntArray, IntArray, IntArray]:
        """Round voxel indices (..., 3) to the nearest voxels of the grid, one array an axis."""
        voxels = np.clip(np.rint(index), 0, np.array(self.shape) - 1).astype(np.int64)
        return voxels[..., 0], voxels[..., 1], voxels[..., 2]

    def centers_mm(self) -> FloatArray:
        """Compute (nx, ny, nz, 3) voxel centres in mm."""
        index = np.stack(np.meshgrid(*(np.arange(n) for n in self.shape), indexing="ij"), axis=-1)
        return self.to_mm(index.astype(np.float64))

    @classmethod
    def axis_aligned(cls, frame: str, shape: tuple[int, int, int], origin_mm: Any, spacing_mm: Any) -> "Grid":
        return cls(frame, shape, origin_mm, np.broadcast_to(spacing_mm, 3), np.eye(3))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Volume:
    """3-D image: `values` (nx, ny, nz) on `grid`."""

    grid: Grid
    values: AnyArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", _owned(self.values, self.grid.shape, "volume"))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class VolumeSeries:
    """Cyclic 4-D image: `values` (n, nx, ny, nz) on one grid, with its phase times."""

    grid: Grid
    values: AnyArray
    timing: CycleTiming

    def __post_init__(self) -> None:
        needed = (len(self.timing), *self.grid.shape)
        object.__setattr__(self, "values", _owned(self.values, needed, "volume series"))

    def phase(self, i: int) -> Volume:
        return Volume(self.grid, self.values[i])

    def fingerprint(self) -> str:
        """Hash (SHA-256, hex) the voxels of all phases, whatever their order, type, geometry and times."""
        phases = (np.ascontiguousarray(values, dtype="<f4") for values in self.values)
        each = sorted(hashlib.sha256(values.data).digest() for values in phases)
        return hashlib.sha256(repr(self.grid.shape).encode("ascii") + b"".join(each)).hexdigest()


def _owned(values: AnyArray, shape: tuple[int, ...], name: str) -> AnyArray:
    """Make an image read-only and contiguous; large images that are both already are not copied."""
    array = np.ascontiguousarray(values)
    if array.shape != shape:
        raise InvalidInputError(f"{name} has shape {array.shape}; its grid and timing need {shape}")
    if array.flags.writeable:
        array = array.copy() if array is values or array.base is not None else array
        array.setflags(write=False)
    return array
