"""The part of a heart's surface that the slices of an examination show."""

from dataclasses import dataclass

import numpy as np

from .arrays import BoolArray, FloatArray, frozen_floats, read_only_arrays
from .errors import InvalidInputError
from .timing.cycle import CycleTiming

RAMP_MM = 3.0
"""Distance from the border of the seen part over which a force falls to zero at the border."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SeenPart:
    """Slabs across the slices, between which the surface is known; beyond them it was closed, not measured.

    Attributes:
        normal: (3,) unit normal of the slices, towards the base.
        bounds_mm: (n, m, 2) lower and upper height `normal @ q` of each of m slabs in each of n phases.
        ends_mm: (2,) heights of the apical and the basal slice at end-diastole.
        sigma_mm: (n,) standard deviation of the base's motion through the slices; it falls linearly to zero
            at the apical slice.
    Raises:
        InvalidInputError: shapes that do not fit, no slab, bounds or ends that do not increase, or negative
            deviations.
    """

    normal: FloatArray
    bounds_mm: FloatArray
    ends_mm: FloatArray
    sigma_mm: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "normal", frozen_floats(self.normal, "normal of the slices", (3,)))
        object.__setattr__(self, "bounds_mm", frozen_floats(self.bounds_mm, "seen slabs", (None, None, 2)))
        object.__setattr__(self, "ends_mm", frozen_floats(self.ends_mm, "ends of the stack", (2,)))
        n = len(self.bounds_mm)
        object.__setattr__(self, "sigma_mm", frozen_floats(self.sigma_mm, "sigma of the base's motion", (n,)))
        if abs(float(np.linalg.norm(self.normal)) - 1.0) > 1e-6:
            raise InvalidInputError("the normal of the slices has not length 1; build the model again")
        if self.bounds_mm.shape[1] == 0 or not (np.diff(self.bounds_mm.reshape(n, -1), axis=1) > 0.0).all():
            raise InvalidInputError("seen slabs must be one or more, with increasing heights")
        if not self.ends_mm[0] < self.ends_mm[1] or (self.sigma_mm < 0.0).any():
            raise InvalidInputError("ends of the stack must increase, and no deviation be negative")

    def heights_mm(self, xyz_mm: FloatArray) -> FloatArray:
        """(...,) heights of (..., 3) points."""
        return np.asarray(xyz_mm @ self.normal)

    def holds(self, xyz_mm: FloatArray, phase: int) -> BoolArray:
        """(...,) True where points on the surface are within a slab in a phase."""
        height = self.heights_mm(xyz_mm)[..., None]
        low, high = self.bounds_mm[phase].T
        return np.asarray(((height >= low) & (height <= high)).any(axis=-1))

    def share(
        self,
        xyz_mm: FloatArray,
        distance_mm: FloatArray,
        gradient: FloatArray,
        phase: float,
        timing: CycleTiming,
    ) -> FloatArray:
        """(n,) share of the force that remains, by the surface points nearest to points; the kernel's twin.

        One within the slabs, zero outside, a smooth step within RAMP_MM of their bounds.

        Args:
            xyz_mm: (n, 3); distance_mm, gradient: (n,) and (n, 3) there.
            phase: of the cycle.
            timing: of the model.
        """
        square = (gradient**2).sum(axis=-1)
        step = np.where(square > 0.04, distance_mm / np.maximum(square, 0.04), 0.0)
        height = self.heights_mm(xyz_mm - step[:, None] * gradient)[:, None]
        low, high = self._bounds_at(phase, timing).T
        within = np.minimum(height - low, high - height).max(axis=1)
        part = np.clip(within / RAMP_MM, 0.0, 1.0)
        return np.asarray(part * part * (3.0 - 2.0 * part))

    def covariance_mm2(self, xyz_mm: FloatArray, phase: FloatArray, timing: CycleTiming) -> FloatArray:
        """(n, 3, 3) covariance of the surface at n points by the base's motion through the slices.

        Args:
            phase: (n,) of the cycle; the largest deviation where it is NaN.
        """
        sigma_mm = np.interp(np.nan_to_num(phase), timing.fractions, self.sigma_mm, period=1.0)
        sigma = np.where(np.isnan(phase), self.sigma_mm.max(), sigma_mm)
        low, high = self.ends_mm
        share = np.clip((self.heights_mm(xyz_mm) - low) / (high - low), 0.0, 1.0)
        return np.asarray((sigma * share)[:, None, None] ** 2 * np.outer(self.normal, self.normal))

    def _bounds_at(self, phase: float, timing: CycleTiming) -> FloatArray:
        """(m, 2) bounds between phases."""
        flat = self.bounds_mm.reshape(len(self.bounds_mm), -1)
        columns = [np.interp(phase, timing.fractions, column, period=1.0) for column in flat.T]
        return np.array(columns).reshape(-1, 2)
