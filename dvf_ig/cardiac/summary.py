"""Summary of a recording's gating: heart rate, and where phase is valid."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, PhaseState, PhaseTrack, read_only_arrays

from .rpeak import RPeak

MIN_BEATS = 5


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class GateSummary:
    """Heart rate and validity of phase over a recording.

    Attributes:
        rate_bpm: 60 / median RR interval.
        valid_share: share of the track's times at which the clock was LOCKED.
        invalid_segments_s: (k, 2) start and stop of each interval in which it was not LOCKED.
    """

    rate_bpm: float
    valid_share: float
    invalid_segments_s: FloatArray


def summarise_gating(peaks: tuple[RPeak, ...], track: PhaseTrack) -> GateSummary:
    """Summarise rate and validity of a whole recording.

    Raises:
        InvalidInputError: fewer than five R peaks, the least for a phase.
    """
    if len(peaks) < MIN_BEATS:
        raise InvalidInputError(
            f"the ECG shows {len(peaks)} R peaks in {track.t_s[-1] - track.t_s[0]:.1f} s, needed at least "
            f"{MIN_BEATS}; check the electrodes and that the file holds an ECG"
        )
    intervals = np.diff([peak.t_s for peak in peaks])
    valid = track.valid
    edges = np.flatnonzero(np.diff(np.concatenate([[True], valid, [True]]).astype(np.int8)))
    starts, stops = edges[::2], edges[1::2]
    last = len(track.t_s) - 1
    segments = [[track.t_s[a], track.t_s[min(b, last)]] for a, b in zip(starts, stops, strict=True)]
    return GateSummary(
        rate_bpm=float(60.0 / np.median(intervals)),
        valid_share=float(valid.mean()),
        invalid_segments_s=np.array(segments, dtype=np.float64).reshape(-1, 2),
    )


def state_segments(track: PhaseTrack) -> tuple[tuple[float, float, PhaseState], ...]:
    """List (start s, stop s, state) of each interval of one state, in order, to cover the whole track."""
    edges = [0, *(np.flatnonzero(np.diff(track.state)) + 1).tolist(), len(track.state)]
    last = len(track.t_s) - 1
    return tuple(
        (float(track.t_s[a]), float(track.t_s[min(b, last)]), PhaseState(int(track.state[a])))
        for a, b in pairwise(edges)
    )
