"""When samples were taken that a recorder handed over in batches, from the times at which each was seen.

A batch holds what came since the one before, so its last sample lies at or a little before the time at which
the batch was stamped:

    stamp = start + (k - 1) / rate + delay,   delay >= 0,   k samples until then, lost ones counted

A line through the stamps over k gives the rate; the smallest delays give the start. Where samples were lost,
the stamps step away from that line and stay away, and by the step one sees how many.
"""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core.arrays import FloatArray, IntArray, read_only_arrays
from dvf_ig.core.errors import InvalidInputError

FEWEST_BATCHES = 10
SMALLEST_DELAYS = 0.05
"""Quantile of the delays that counts as none: one stamp that comes early must not shift every sample."""
NEIGHBOURS, NEIGHBOURHOOD_S = 10, 0.05
"""Batches on each side of a step that say how large it is: at least this many, and at least this long."""
INTERVAL_S = 0.2
LEAST_LATE = 0.2
"""Quantile of the lateness of neighbours that is compared: batches stamped late for a moment lose nothing."""
PLAUSIBLE_SPREAD_S = 0.1


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BatchTimes:
    """Where on an even raster of samples each batch ends.

    Attributes:
        rate_hz: of the raster.
        start_s: time of its sample 0, the first of the first batch.
        last: (b,) index of each batch's last sample.
        spread_s: half the range of 90 % of the stamps about the line: what a sample's time is good to.
    """

    rate_hz: float
    start_s: float
    last: IntArray
    spread_s: float


def fit_batch_times(counts: IntArray, stamps_s: FloatArray) -> BatchTimes:
    """Times of batched samples.

    Args:
        counts: (b,) samples in each batch, at least 1.
        stamps_s: (b,) increasing; each not before its batch's last sample.
    Raises:
        InvalidInputError: fewer than FEWEST_BATCHES, or stamps that no even sampling explains.
    """
    if len(counts) < FEWEST_BATCHES:
        raise InvalidInputError(
            f"samples came with {len(counts)} frames, too few to tell when they were taken; needed "
            f"{FEWEST_BATCHES}"
        )
    delivered = np.cumsum(counts)
    ends, period_s = delivered, _local_period_s(delivered, stamps_s)
    for _ in range(2):  # the first line is less precise than those on which losses are known
        late_s = stamps_s - period_s * delivered
        ends = delivered + np.cumsum(_lost_before(counts, late_s, stamps_s, 1 / period_s))
        period_s = _slope(ends.astype(np.float64), stamps_s)
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


def _local_period_s(ends: IntArray, stamps_s: FloatArray) -> float:
    """Median over short intervals: few of them contain a loss."""
    usual_s = float(np.median(np.diff(stamps_s)))
    lag = int(np.clip(round(INTERVAL_S / usual_s), 1, len(ends) // 2))
    return float(np.median((stamps_s[lag:] - stamps_s[:-lag]) / (ends[lag:] - ends[:-lag])))


def _lost_before(counts: IntArray, late_s: FloatArray, stamps_s: FloatArray, rate_hz: float) -> IntArray:
    """(b,) samples lost just before each batch: where lateness steps up and stays up."""
    least = max(1.5, 0.5 * float(np.median(counts))) / rate_hz
    width = max(NEIGHBOURS, round(NEIGHBOURHOOD_S / float(np.median(np.diff(stamps_s)))))
    steps = np.flatnonzero(np.diff(late_s) > least) + 1
    edges = [0, *steps.tolist(), len(counts)]
    lost = np.zeros(len(counts), dtype=np.int64)
    for before, at, after in zip(edges[:-2], edges[1:-1], edges[2:], strict=True):
        earlier = np.quantile(late_s[max(before, at - width) : at], LEAST_LATE)
        later = np.quantile(late_s[at : min(after, at + width)], LEAST_LATE)
        if later - earlier > least:
            lost[at] = round(float(later - earlier) * rate_hz)
    return lost


def _slope(x: FloatArray, y: FloatArray) -> float:
    """dy/dx by least squares; points far from the line are left out twice."""
    kept = np.ones(len(x), dtype=np.bool_)
    slope = 0.0
    for _ in range(3):
        middle = x[kept].mean()
        slope = float((x[kept] - middle) @ (y[kept] - y[kept].mean()) / ((x[kept] - middle) ** 2).sum())
        rest = y - slope * x
        off = np.abs(rest - np.median(rest))
        kept = off <= max(4.5 * float(np.median(off)), 1e-9)
    return slope
