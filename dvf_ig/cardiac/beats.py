"""Retrospective phase between two known R peaks, for gating once the beat is over."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, read_only_arrays

MAX_RR_DEVIATION = 0.2
"""A beat is regular when its RR is within this share of the median of its neighbourhood."""
NEIGHBOURS = 4
"""Beats on each side that form the neighbourhood."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BeatPhase:
    """Phase of times between R peaks.

    Attributes:
        phi: (n,) fraction of the enclosing RR interval, [0, 1); 0 outside any.
        rr_s: (n,) length of that interval; NaN outside any.
        regular: (n,) True if the beat is complete and neither it nor the one before was early or late.
    """

    phi: FloatArray
    rr_s: FloatArray
    regular: BoolArray


def beat_phase(r_peaks_s: FloatArray, t_s: FloatArray) -> BeatPhase:
    """Compute phase at `t_s` from the R peaks before and after it.

    Args:
        r_peaks_s: (k,) increasing.
        t_s: (n,) times at which phase is computed.
    """
    n = len(t_s)
    if len(r_peaks_s) < 2:
        return BeatPhase(np.zeros(n), np.full(n, np.nan), np.zeros(n, dtype=np.bool_))
    rr = np.diff(r_peaks_s)
    normal = np.array([np.median(rr[max(0, k - NEIGHBOURS) : k + NEIGHBOURS + 1]) for k in range(len(rr))])
    regular = np.abs(rr - normal) <= MAX_RR_DEVIATION * normal
    regular[1:] &= np.abs(rr[:-1] - normal[:-1]) <= MAX_RR_DEVIATION * normal[:-1]
    beat = np.searchsorted(r_peaks_s, t_s, side="right") - 1
    inside = (beat >= 0) & (beat < len(rr))
    safe = np.clip(beat, 0, len(rr) - 1)
    phi = np.where(inside, (t_s - r_peaks_s[safe]) / rr[safe], 0.0)
    return BeatPhase(phi, np.where(inside, rr[safe], np.nan), inside & regular[safe])
