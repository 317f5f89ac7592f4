"""Scale of a breathing surrogate: a channel or marker becomes ρ, 0 at end-expiration, 1 at the usual top."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, read_only_arrays

RANGE_TO_NOISE = 5.0
"""Smallest range of a breath relative to the noise of a sample; below it nothing is seen to breathe."""
LOW, HIGH = 10.0, 95.0
"""Percentiles that stand for end-expiration and the top of a breath."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class SurrogateScale:
    """Linear map from a sample's columns to ρ.

    Attributes:
        origin: (columns,); direction: (columns,) per unit of ρ.
    """

    origin: FloatArray
    direction: FloatArray

    def rho(self, values: FloatArray) -> FloatArray:
        """Compute (n,) ρ of (n, columns) values."""
        return np.asarray((values - self.origin) @ self.direction)


def learn_scale(values: FloatArray) -> SurrogateScale | None:
    """Learn the scale from (n, columns) values of some breaths; None if nothing is seen to breathe.

    The direction is that of the largest variance, signed so that the longest part of a breath, its rest, is
    low.
    """
    middle = np.median(values, axis=0)
    _, axes = np.linalg.eigh(np.cov(values.T).reshape(values.shape[1], -1))
    along = (values - middle) @ axes[:, -1]
    noise = np.median(np.abs(np.diff(along, n=2))) / 0.6745 / np.sqrt(6.0)
    low, high = np.percentile(along, (LOW, HIGH))
    if not high - low > RANGE_TO_NOISE * max(noise, 1e-12):
        return None
    centre = 0.5 * (np.percentile(along, 2) + np.percentile(along, 98))
    sign = 1.0 if np.median(along) <= centre else -1.0
    low, high = np.percentile(sign * along, (LOW, HIGH))
    direction = sign * axes[:, -1] / (high - low)
    return SurrogateScale(middle + low * sign * axes[:, -1], direction)
