"""Statistics of trials: shares, estimates over hearts, and how they are printed; all intervals are of 95 %.

Shares have Wilson intervals (Wilson 1927), rates exact Poisson intervals (Garwood 1936), statistics
percentile bootstrap intervals over resampled hearts (Efron and Tibshirani 1993, ch. 13).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2, norm, rankdata

SUCCESS_MM, FAILURE_MM = 2.0, 3.0
"""A registration with a mean target error below the first is a success, above the second a failure."""
RESAMPLES = 2000
LEAST_HEARTS = 2
"""Fewer have no interval."""


@dataclass(frozen=True, slots=True)
class Share:
    """`count` of `of` with its interval; share and interval are None if there is nothing to count."""

    count: int
    of: int
    share: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True)
class Estimate:
    """A statistic over hearts with its interval; None if there are too few."""

    value: float | None
    low: float | None
    high: float | None


def share_of(count: int, of: int, independent: int | None = None) -> Share:
    """Share of trials with its Wilson interval.

    Args:
        independent: number of trials that varied independently; None: all.
    """
    if of == 0:
        return Share(0, 0, None, None, None)
    n, share, z2 = independent or of, count / of, float(norm.ppf(0.975)) ** 2
    middle = (share + z2 / (2 * n)) / (1 + z2 / n)
    half = math.sqrt(z2 * (share * (1 - share) / n + z2 / (4 * n**2))) / (1 + z2 / n)
    return Share(count, of, share, max(0.0, middle - half), min(1.0, middle + half))


def bootstrap(
    values: Sequence[float], statistic: Callable[..., Any], hearts: Sequence[int] | None = None
) -> Estimate:
    """A statistic of values with its percentile interval over resampled hearts.

    Args:
        statistic: of an array along `axis`, for example np.median.
        hearts: heart of each value; None: one each.
    """
    numbers = np.array(values, dtype=np.float64)
    if len(numbers) == 0:
        return Estimate(None, None, None)
    value = float(statistic(numbers, axis=0))
    own = np.unique(range(len(numbers)) if hearts is None else hearts, return_inverse=True)[1].ravel()
    count = int(own.max()) + 1
    if count < LEAST_HEARTS:
        return Estimate(value, None, None)
    drawn = np.random.default_rng(0).integers(0, count, size=(RESAMPLES, count))
    if count == len(numbers):
        resampled = statistic(numbers[np.argsort(own)][drawn], axis=1)
    else:
        members = [numbers[own == heart] for heart in range(count)]
        resampled = [statistic(np.concatenate([members[heart] for heart in row]), axis=0) for row in drawn]
    low, high = np.percentile(resampled, [2.5, 97.5])
    return Estimate(value, float(low), float(high))


def share_over_hearts(by_heart: Sequence[Sequence[bool]]) -> Estimate:
    """Share of all trials that are true, with its interval over resampled hearts."""
    hits = np.array([sum(trials) for trials in by_heart], dtype=np.float64)
    sizes = np.array([len(trials) for trials in by_heart], dtype=np.float64)
    if sizes.sum() == 0:
        return Estimate(None, None, None)
    drawn = np.random.default_rng(0).integers(0, len(sizes), size=(RESAMPLES, len(sizes)))
    shares = hits[drawn].sum(axis=1) / np.maximum(sizes[drawn].sum(axis=1), 1.0)
    low, high = np.percentile(shares, [2.5, 97.5])
    return Estimate(float(hits.sum() / sizes.sum()), float(low), float(high))


def poisson_rate(count: int, hours: float) -> Estimate:
    """Events an hour with the exact interval; None if there was no time."""
    if hours <= 0.0:
        return Estimate(None, None, None)
    low = float(chi2.ppf(0.025, 2 * count)) / 2.0 if count else 0.0
    high = float(chi2.ppf(0.975, 2 * count + 2)) / 2.0
    return Estimate(count / hours, low / hours, high / hours)


def auc_of(failures: Sequence[float], successes: Sequence[float]) -> float | None:
    """Probability that a success has the higher value (Mann and Whitney 1947), ties half; NaN is left out."""
    bad = np.array([p for p in failures if math.isfinite(p)])
    good = np.array([p for p in successes if math.isfinite(p)])
    if len(bad) == 0 or len(good) == 0:
        return None
    ranks = rankdata(np.concatenate([good, bad]))[: len(good)]
    return float((ranks.sum() - len(good) * (len(good) + 1) / 2) / (len(good) * len(bad)))


def calibration_error(stated: Sequence[float], succeeded: Sequence[bool]) -> float | None:
    """Expected calibration error over tenths of the stated probability (Naeini et al. 2015)."""
    if not stated:
        return None
    p, good = np.array(stated), np.array(succeeded, dtype=np.float64)
    tenth = np.minimum((10 * p).astype(int), 9)
    apart = [abs(float((p - good)[tenth == t].sum())) for t in np.unique(tenth)]
    return sum(apart) / len(p)


def calibration_error_by_chance(stated: Sequence[float]) -> float | None:
    """Mean `calibration_error` of successes drawn with the stated probabilities."""
    if not stated:
        return None
    p = np.array(stated)
    drawn = np.random.default_rng(0).random((RESAMPLES, len(p))) < p
    tenth = np.minimum((10 * p).astype(int), 9)
    apart = [np.abs((p - drawn)[:, tenth == t].sum(axis=1)) for t in np.unique(tenth)]
    return float(np.sum(apart, axis=0).mean() / len(p))


def median_of(values: Sequence[Any]) -> float | None:
    """Median; None if there are no values."""
    return float(np.median(values)) if values else None


def number_text(value: float | None, form: str = "{:.2f}", none: str = "–") -> str:
    """A number for a table."""
    return none if value is None else form.format(value)


def estimate_text(estimate: Estimate, form: str = "{:.2f}", to: str = "–") -> str:
    """An estimate for a table: value (low–high)."""
    if estimate.value is None or estimate.low is None or estimate.high is None:
        return number_text(estimate.value, form)
    return f"{form.format(estimate.value)} ({form.format(estimate.low)}{to}{form.format(estimate.high)})"


def share_text(share: Share) -> str:
    """A share for a table: count of all: share (low–high)."""
    if share.share is None or share.low is None or share.high is None:
        return "–"
    return f"{share.count} of {share.of}: {share.share:.0%} ({share.low:.0%}–{share.high:.0%})"
