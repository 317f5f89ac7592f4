"""Lead-off detection: flat, railed or missing samples of each ECG lead."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, IntArray

FLAT_S = 0.2
"""A lead that keeps one value, or has no samples, for this long is off (LOST: docs/theory/cardiac.md)."""
RESTING_S = 1.5
"""A lead that came to rest between beats, as a clean or coarsely digitised one does, is off after this:
longer than the rest between two beats at 40 per minute."""
APPROACH_S = 0.06
"""Stretch before a flat one by which rest is distinguished from loss."""
MOST_TURNS = 3
"""Turns of the signal within a QRS complex (Q, R and S)."""
EXTREME_SHARE = 0.5
"""A flat value at an end of a lead's range, this share of it away from the mean, is saturation."""

LeadOffCause = Literal[
    "", "lead off (flat line)", "saturation", "samples missing", "samples skipped", "double pulse"
]
_CAUSES: tuple[LeadOffCause, ...] = ("", "lead off (flat line)", "saturation", "samples missing")


@dataclass(frozen=True, slots=True)
class LeadChange:
    """Time at which the whole ECG was lost (`on` False) or came back (`on` True), and why it was lost."""

    t_s: float
    on: bool
    cause: LeadOffCause = ""


class LeadOffDetector:
    """Streaming test of every lead for one repeated value (rail, unplugged) or missing samples (NaN)."""

    def __init__(self, rate_hz: float, leads: int) -> None:
        self._leads = [_Lead(rate_hz) for _ in range(leads)]

    def push(self, samples: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Convert (n, leads) samples, NaN if missing, to samples with gaps filled, and lead-off flags."""
        columns = [lead.push(column) for lead, column in zip(self._leads, samples.T, strict=True)]
        return np.column_stack([filled for filled, _ in columns]), np.column_stack(
            [off for _, off in columns]
        )

    def cause(self, index: int) -> LeadOffCause:
        """Return why the first lead is off at a sample of the last chunk."""
        return _CAUSES[int(self._leads[0].causes[index])]


class _Lead:
    """Runs of equal and of missing samples of one lead; `causes` are those of the last chunk, by _CAUSES."""

    def __init__(self, rate_hz: float) -> None:
        self._flat, self._resting = max(2, round(FLAT_S * rate_hz)), max(2, round(RESTING_S * rate_hz))
        self._width = max(3, round(APPROACH_S * rate_hz))
        self._tail = np.zeros(0)  # the last samples of the chunks before
        self._quantum = np.inf  # smallest step seen
        self._equal, self._missing = 0, 0  # lengths of the runs that have not ended
        self._limit, self._cause = self._resting, 1  # of the run of equal samples that has not ended
        self._low, self._high, self._sum, self._count = np.inf, -np.inf, 0.0, 0
        self.causes = np.zeros(0, np.int8)

    def push(self, column: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Fill gaps in (n,) samples with the last value, and mark samples at which the lead is off."""
        n, finite = len(column), np.isfinite(column)
        before = self._tail if len(self._tail) else np.array([column[0] if finite[0] else 0.0])
        last = np.maximum.accumulate(np.where(finite, np.arange(n), -1))
        joined = np.concatenate([before, np.where(last >= 0, column[np.maximum(last, 0)], before[-1])])
        filled = joined[len(before) :]
        steps = np.abs(np.diff(joined)[len(before) - 1 :])
        quanta = np.minimum.accumulate(np.concatenate([[self._quantum], np.where(steps == 0, np.inf, steps)]))
        equal, missing = _runs(steps == 0, self._equal), _runs(~finite, self._missing)
        limits, causes = np.full(n, self._flat), np.ones(n, np.int8)
        begins = np.flatnonzero(steps)
        ends = np.append(begins[1:], n)[: len(begins)]
        limits[: begins[0] if len(begins) else n] = self._limit
        causes[: begins[0] if len(begins) else n] = self._cause
        long = (ends - begins > self._flat) | (ends == n)
        for begin, end in zip(begins[long].tolist(), ends[long].tolist(), strict=True):
            at = len(before) + begin
            self._limit = self._limit_of(joined[max(at - self._width, 0) : at + 1], quanta[begin + 1])
            self._cause = self._cause_of(filled[:begin], float(filled[begin]))
            limits[begin:end], causes[begin:end] = self._limit, self._cause
        causes[missing >= self._flat] = 3
        self._tail, self._quantum = joined[-self._width - 1 :], float(quanta[-1])
        self._equal, self._missing = int(equal[-1]), int(missing[-1])
        self._low, self._high = min(self._low, float(filled.min())), max(self._high, float(filled.max()))
        self._sum, self._count = self._sum + float(filled.sum()), self._count + n
        self.causes = causes
        return filled, (equal >= limits) | (missing >= self._flat)

    def _limit_of(self, approach: FloatArray, quantum: float) -> int:
        """Return after how many equal samples the lead is off, from the samples before and the first of them.

        It came to rest if steps of more than one quantum turn no more often than in a QRS complex, as noise
        does, and the last step is about as small as the smallest, as a jump to a rail is not.
        """
        steps = np.diff(approach)
        if len(steps) < 3:
            return self._resting  # the recording begins
        large = np.sign(steps[np.abs(steps) > 1.5 * quantum])
        turns = int(np.count_nonzero(np.diff(large)))
        earlier = np.abs(steps[:-1][steps[:-1] != 0])
        smallest = max(quantum, float(earlier.min()) if len(earlier) else 0.0)
        few = min(MOST_TURNS, max(2, len(steps) // 5))
        return self._resting if turns <= few and abs(steps[-1]) <= 2.5 * smallest else self._flat

    def _cause_of(self, chunk: FloatArray, value: float) -> int:
        """Return the cause of a run at `value`, from all samples before it."""
        low, high = min(self._low, chunk.min(initial=np.inf)), max(self._high, chunk.max(initial=-np.inf))
        count = self._count + len(chunk)
        if not count or low < value < high:
            return 1
        mean = (self._sum + float(chunk.sum())) / count
        return 2 if abs(value - mean) >= EXTREME_SHARE * (max(high, value) - min(low, value)) else 1


def _runs(same: BoolArray, before: int) -> IntArray:
    """Count (n,) the samples of each run up to now; `before` had passed when the first came."""
    index = np.arange(len(same))
    last = np.maximum.accumulate(np.where(same, -1, index))
    return np.where(last >= 0, index - last, index + 1 + before)
