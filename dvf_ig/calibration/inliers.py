"""Inliers of a least-squares fit: residuals within some robust standard deviations, refitted until stable.

Pivot, N-wire, cross-wire, wall, hand–eye and dwell fits all use this rule.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from scipy.stats import chi2

from dvf_ig.core import BoolArray, FloatArray, read_only_arrays

LEAST_LIMIT = 1e-6
"""Smallest limit, in the residuals' unit: what rounding leaves of exact data counts as an inlier."""
MIN_INLIERS = 3
"""Fewest samples that are fitted."""
MAX_ROUNDS = 50
MEDIAN_LENGTH = float(np.sqrt(chi2.ppf(0.5, 3)))
"""Median length of a 3-D Gaussian vector over the standard deviation of a coordinate (Maxwell)."""

M = TypeVar("M")


@dataclass(frozen=True, slots=True)
class InlierRule:
    """Rule that selects inliers by the lengths of their residuals.

    Attributes:
        keep_sigma: an inlier's residual is at most this many robust standard deviations long.
        dimensions: components of one residual vector; they relate its median length to a standard deviation.
        scale_from_inliers: the standard deviation is that of the current inliers, not of all samples.
        scale_below: residuals longer than this take no part in the standard deviation.
    """

    keep_sigma: float = 5.0
    dimensions: int = 3
    scale_from_inliers: bool = False
    scale_below: float = np.inf

    def limit(self, lengths: FloatArray, inliers: BoolArray) -> float:
        """Compute an inlier's longest residual from (n,) or (n, k) lengths and the (n,) current inliers."""
        near = lengths[inliers] if self.scale_from_inliers else lengths
        near = near[near <= self.scale_below]
        sigma = robust_sd(near, self.dimensions) if near.size else 0.0
        return max(self.keep_sigma * sigma, LEAST_LIMIT)

    def select(
        self, lengths: Sequence[FloatArray], inliers: BoolArray
    ) -> tuple[BoolArray, tuple[float, ...]]:
        """Select the (n,) samples within the limit of every measure; also return the limits.

        Args:
            lengths: of each measure (millimetres, degrees), (n,) or (n, k); all k must be within the limit.
            inliers: (n,) current ones.
        """
        limits = tuple(self.limit(measure, inliers) for measure in lengths)
        within = [
            (measure <= limit).reshape(len(measure), -1).all(axis=1)
            for measure, limit in zip(lengths, limits, strict=True)
        ]
        return np.logical_and.reduce(within), limits


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Consensus(Generic[M]):
    """A fit and the samples that agree with it.

    Attributes:
        model: fitted to the inliers; None if they determine none.
        inliers: (n,).
        limits: longest residual of an inlier, of each measure.
    """

    model: M | None
    inliers: BoolArray
    limits: tuple[float, ...]


def robust_sd(lengths: FloatArray, dimensions: int = 3) -> float:
    """Estimate the SD of one component of Gaussian residual vectors from the median of their lengths.

    The median squared length is that of a chi-squared distribution times the variance: see MEDIAN_LENGTH.
    """
    return float(np.median(lengths)) / float(np.sqrt(chi2.ppf(0.5, dimensions)))


def fit_inliers(
    fit: Callable[[BoolArray, M | None], M | None],
    lengths: Callable[[M], Sequence[FloatArray]],
    start: BoolArray,
    rule: InlierRule,
) -> Consensus[M]:
    """Fit and select in alternation until the inliers no longer change.

    Args:
        fit: the model of the given inliers, from the last model (None at first); None if the inliers do
            not determine one.
        lengths: residual lengths of all samples under a model, one array a measure.
        start: (n,) first inliers.
        rule: which residuals are those of inliers.
    """

    def fitted(inliers: BoolArray, last: M | None) -> M | None:
        return fit(inliers, last) if inliers.sum() >= MIN_INLIERS else None

    model: M | None = None
    inliers = start
    limits: tuple[float, ...] = ()
    for _ in range(MAX_ROUNDS):
        model = fitted(inliers, model)
        if model is None:
            return Consensus(None, inliers, limits)
        again, limits = rule.select(lengths(model), inliers)
        if np.array_equal(again, inliers):
            return Consensus(model, inliers, limits)
        inliers = again
    return Consensus(fitted(inliers, model), inliers, limits)
