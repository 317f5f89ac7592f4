"""Lead-off detection: flat, railed or missing samples of each ECG lead."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray

FLAT_S = 0.2
"""A lead that keeps one value, or has no samples, for this long is off (LOST: docs/theory/cardiac.md)."""


@dataclass(frozen=True, slots=True)
class LeadChange:
    """Time at which the ECG as a whole was lost (`on` False) or came back (`on` True)."""

    t_s: float
    on: bool


class LeadOffDetector:
    """Streaming test of every lead for one repeated value (rail, unplugged) or missing samples (NaN)."""

    def __init__(self, rate_hz: float, leads: int) -> None:
        self._limit = max(2, round(FLAT_S * rate_hz))
        self._held = np.zeros(leads)
        self._run = np.zeros(leads, dtype=np.int64)
        self._started = False

    def push(self, samples: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Convert (n, leads) samples, NaN if missing, to samples with gaps filled, and lead-off flags."""
        if not self._started:
            self._held = np.where(np.isfinite(samples[0]), samples[0], 0.0)
            self._started = True
        filled = np.empty_like(samples)
        off = np.empty(samples.shape, dtype=np.bool_)
        for lead in range(samples.shape[1]):
            filled[:, lead], off[:, lead] = self._push_lead(samples[:, lead], lead)
        return filled, off

    def _push_lead(self, column: FloatArray, lead: int) -> tuple[FloatArray, BoolArray]:
        n = len(column)
        index = np.arange(n)
        last = np.maximum.accumulate(np.where(np.isfinite(column), index, -1))
        filled = np.where(last >= 0, column[np.maximum(last, 0)], self._held[lead])
        before = np.concatenate([[self._held[lead]], filled[:-1]])
        changed = np.maximum.accumulate(np.where(filled != before, index, -1))
        run = np.where(changed >= 0, index - changed, index + 1 + self._run[lead])
        self._held[lead], self._run[lead] = filled[-1], run[-1]
        return filled, run >= self._limit
