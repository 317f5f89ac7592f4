"""Estimate when samples were taken that a recorder received in batches, from the arrival time of each batch.

A batch holds the samples since the previous one, so its last sample was taken at or shortly before the time
stamp of the batch:

    stamp = start + (k - 1) / rate + delay,   delay >= 0,   k samples up to then, including lost ones

A line through the stamps over k gives the rate; the smallest delays give the start. When samples are lost,
the stamps step away from that line for good, and the step gives their number.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, IntArray, InvalidInputError, read_only_arrays

FEWEST_BATCHES = 10
SMALLEST_DELAYS = 0.05
"""Quantile of the delays that counts as zero: one early stamp must not shift every sample."""
NEIGHBOURS, NEIGHBOURHOOD_S = 10, 0.05
"""Batches on each side that determine the size of a step: at least this number, over at least this time."""
USUAL_STEPS, ROUNDS = 0.2, 4
"""Quantile of the time per sample that gives the first guess: losses increase it, never decrease it."""
LEAST_LATE = 0.2
"""Quantile of the lateness of neighbours that is compared, so that a brief delay is not taken for a loss."""
PLAUSIBLE_SPREAD_S = 0.1


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BatchTimes:
    """Position of the end of each batch on an even raster of samples.

    Attributes:
        rate_hz: of the raster.
        start_s: time of its sample 0, the first of the first batch.
        last: (b,) index of each batch's last sample.
        spread_s: half the range of 90 % of the stamps about the line: the accuracy of a sample's time.
    """

    rate_hz: float
    start_s: float
    last: IntArray
    spread_s: float


def fit_batch_times(counts: IntArray, stamps_s: FloatArray) -> BatchTimes:
    """Estimate the times of batched samples.

    Args:
        counts: (b,) samples in each batch, at least 1.
        stamps_s: (b,) increasing; each not before its batch's last sample.
    Raises:
        InvalidInputError: fewer than FEWEST_BATCHES, or stamps that no even sampling explains.
    """
    if len(counts) < FEWEST_BATCHES:
        raise InvalidInputError(
            f"samples came with {len(counts)} frames, not enough to estimate their times; "
            f"needed at least {FEWEST_BATCHES}"
        )
    delivered = np.cumsum(counts)
    period_s = float(np.quantile(np.diff(stamps_s) / counts[1:], USUAL_STEPS))
    run = np.zeros(len(counts), dtype=np.int64)
    for _ in range(ROUNDS):  # the first period is rough; runs and period improve each other
        run = _uninterrupted(counts, stamps_s - period_s * delivered, stamps_s, period_s)
        period_s = _slope(delivered, stamps_s, run)
    ends = delivered + _lost_until(stamps_s - period_s * delivered, run, period_s)[run]
    period_s = _slope(ends, stamps_s, np.zeros(len(ends), dtype=np.int64))
    delays_s = stamps_s - period_s * (ends - 1)
    start_s = float(np.quantile(delays_s, SMALLEST_DELAYS))
    low, high = np.quantile(delays_s, [0.05, 0.95])
    spread_s = float(high - low) / 2
    if spread_s > max(PLAUSIBLE_SPREAD_S, float(np.median(np.diff(stamps_s)))):
        raise InvalidInputError(
            f"samples do not come evenly: the frames' time stamps lie up to {spread_s:.2g} s from a line "
            "over their number; record the time of each frame's first sample with it"
        )
    return BatchTimes(1 / period_s, start_s, np.asarray(ends - 1, dtype=np.int64), spread_s)


def _uninterrupted(counts: IntArray, late_s: FloatArray, stamps_s: FloatArray, period_s: float) -> IntArray:
    """Number the run without loss, (b,), that each batch belongs to: lateness steps up between runs."""
    usual = float(np.median(counts))
    least_s = period_s * (0.5 if usual == 1 else max(1.5, 0.5 * usual))
    width = max(NEIGHBOURS, round(NEIGHBOURHOOD_S / float(np.median(np.diff(stamps_s)))))
    steps = np.flatnonzero(np.diff(late_s) > least_s) + 1
    edges = [0, *steps.tolist(), len(counts)]
    begins = np.zeros(len(counts), dtype=np.int64)
    for before, at, after in zip(edges[:-2], edges[1:-1], edges[2:], strict=True):
        earlier = np.quantile(late_s[max(before, at - width) : at], LEAST_LATE)
        later = np.quantile(late_s[at : min(after, at + width)], LEAST_LATE)
        begins[at] = later - earlier > least_s
    return np.asarray(np.cumsum(begins))


def _lost_until(late_s: FloatArray, run: IntArray, period_s: float) -> IntArray:
    """Count the samples lost before each run, (runs,), in total, so that errors do not accumulate."""
    edges = np.searchsorted(run, np.arange(run[-1] + 2))
    base_s = [np.quantile(late_s[a:b], LEAST_LATE) for a, b in itertools.pairwise(edges)]
    lost = np.rint((np.array(base_s) - base_s[0]) / period_s).astype(np.int64)
    return np.asarray(np.maximum.accumulate(lost))


def _slope(x: IntArray, y: FloatArray, run: IntArray) -> float:
    """Fit dy/dx by least squares with an intercept per run, without outliers."""
    inliers, slope = np.ones(len(x), dtype=np.bool_), 0.0
    for _ in range(3):
        dx, dy = _centred(x.astype(np.float64), run, inliers), _centred(y, run, inliers)
        slope = float(dx[inliers] @ dy[inliers] / max(float(dx[inliers] @ dx[inliers]), 1e-300))
        off = np.abs(dy - slope * dx)
        inliers = off <= max(4.5 * float(np.median(off)), 1e-9)
    return slope


def _centred(values: FloatArray, run: IntArray, inliers: BoolArray) -> FloatArray:
    """Subtract from (b,) values the mean of the inliers of their run."""
    total = np.bincount(run[inliers], values[inliers], minlength=run[-1] + 1)
    count = np.bincount(run[inliers], minlength=run[-1] + 1)
    return np.asarray(values - (total / np.maximum(count, 1))[run])
