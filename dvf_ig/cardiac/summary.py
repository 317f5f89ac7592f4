"""Summary of a recording's gating: heart rate, and where phase is valid."""

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, PhaseState, PhaseTrack, read_only_arrays

from .lead_off import LeadChange
from .phase_clock import MIN_QUALITY
from .rpeak import RPeak

MIN_BEATS = 5
_NOISE = "R peaks low or noisy"
_WHY = {
    PhaseState.INIT: "learning the rhythm",
    PhaseState.LOCKED: "",
    PhaseState.SUSPECT: "early or uncertain beat",
    PhaseState.LOST: "no R peak found",
    PhaseState.IRREGULAR: "irregular rhythm",
}


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class GateSummary:
    """Heart rate and validity of phase over a recording.

    Attributes:
        rate_bpm: 60 / median RR interval.
        valid_share: share of the track's times at which the clock was LOCKED.
        invalid_segments_s: (k, 2) start and stop of each interval in which it was not LOCKED.
        invalid_reasons: (k) why, for each of them: all reasons, that of the longest time first.
    """

    rate_bpm: float
    valid_share: float
    invalid_segments_s: FloatArray
    invalid_reasons: tuple[str, ...]


def summarise_gating(
    peaks: tuple[RPeak, ...], track: PhaseTrack, changes: tuple[LeadChange, ...] = ()
) -> GateSummary:
    """Summarise rate and validity of a whole recording.

    Args:
        peaks: R peaks in order.
        track: phase over the recording.
        changes: losses and returns of the ECG, in order.
    Raises:
        InvalidInputError: fewer than five R peaks, the least for a phase.
    """
    if len(peaks) < MIN_BEATS:
        causes = ", ".join(dict.fromkeys(change.cause for change in changes if change.cause))
        why = f" ({causes})" if causes else ""
        raise InvalidInputError(
            f"the ECG shows {len(peaks)} R peaks in {track.t_s[-1] - track.t_s[0]:.1f} s{why}, needed at "
            f"least {MIN_BEATS}; check the electrodes, the sampling rate, and that the file holds an ECG"
        )
    intervals = np.diff([peak.t_s for peak in peaks])
    valid = track.valid
    edges = np.flatnonzero(np.diff(np.concatenate([[True], valid, [True]]).astype(np.int8)))
    starts, stops = edges[::2], edges[1::2]
    last = len(track.t_s) - 1
    segments = [[track.t_s[a], track.t_s[min(b, last)]] for a, b in zip(starts, stops, strict=True)]
    whys = _whys(peaks, track, changes)
    reasons = tuple(_longest_first(whys[a:b]) for a, b in zip(starts, stops, strict=True))
    return GateSummary(
        rate_bpm=float(60.0 / np.median(intervals)),
        valid_share=float(valid.mean()),
        invalid_segments_s=np.array(segments, dtype=np.float64).reshape(-1, 2),
        invalid_reasons=reasons,
    )


def _whys(peaks: tuple[RPeak, ...], track: PhaseTrack, changes: tuple[LeadChange, ...]) -> list[str]:
    """Return (n) reasons why the phase is not valid at each time; "" while it is valid."""
    beats = np.array([peak.detected_at_s for peak in peaks])
    beat = np.searchsorted(beats, track.t_s, side="right") - 1
    weak = np.array([peak.quality < MIN_QUALITY for peak in peaks])[np.maximum(beat, 0)]
    lost = np.array([change.t_s for change in changes if not change.on])
    causes = [change.cause for change in changes if not change.on]
    loss = np.searchsorted(lost, track.t_s, side="right") - 1
    whys, since = [], 0  # since: first time of the running LOST
    for k, state in enumerate(track.state.tolist()):
        since = k if k and state != track.state[k - 1] else since
        if (
            state in (PhaseState.LOST, PhaseState.INIT)
            and loss[k] >= 0
            and (state == PhaseState.INIT or lost[loss[k]] >= track.t_s[max(since - 1, 0)])
        ):
            whys.append(causes[loss[k]])
        elif state == PhaseState.SUSPECT and weak[k]:
            whys.append(_NOISE)
        else:
            whys.append(_WHY[PhaseState(state)])
    return whys


def _longest_first(whys: list[str]) -> str:
    """Join the different reasons, that of the longest time first."""
    return ", ".join(why for why, _ in Counter(whys).most_common())


def state_segments(track: PhaseTrack) -> tuple[tuple[float, float, PhaseState], ...]:
    """List (start s, stop s, state) of each interval of one state, in order, to cover the whole track."""
    edges = [0, *(np.flatnonzero(np.diff(track.state)) + 1).tolist(), len(track.state)]
    last = len(track.t_s) - 1
    return tuple(
        (float(track.t_s[a]), float(track.t_s[min(b, last)]), PhaseState(int(track.state[a])))
        for a, b in pairwise(edges)
    )
