"""Whether the heart in the images beats as the ECG says: the rhythm of the images alone against the ECG's.

The images' changes are fitted as in `ecg_delay`, with the phase of a metronome in place of the ECG's, which
may run ahead or behind by a random walk over the beats (Viterbi 1967) and whose rate is searched. If that
explains the images far better than the ECG at its best constant delay, the beats of the ECG are not those of
this heart: a recorder's clock that is off explains a delay, but not intervals that do not match.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvf_ig.core import FloatArray, IntArray

from .ecg_delay import (
    LEAST_PAIRS,
    PAIRS_A_BEAT,
    SHIFTS,
    CycleSpeed,
    EcgDelay,
    ImageChange,
    ecg_delay,
    residual_of_fit,
    residuals_with,
    shifted_speeds,
    without_heart,
)

RATES_RR_S = 0.4 * 1.04 ** np.arange(36)
"""RR intervals that are tried: 150 to 38 beats/min."""
WANDER = 0.04
"""Standard deviation by which a beat's length differs from the metronome's, as a share of it."""
STARTS, ROUNDS = 3, 5
STRETCHES = 1.0 + np.linspace(-0.05, 0.05, 21)
"""Factors of a wrong sampling rate, such as 256 Hz for 250, tried before an ECG is called foreign."""
AGREES_LOG_RATIO, FOREIGN_LOG_RATIO = 6.0, 12.0
"""Between the images' own rhythm and the ECG: -2 to -5 for the true ECG of two hearts (calm, ectopy), above
12 in 126 of 132 ECGs of other people (MIT-BIH) set to the same mean rate; the other 6 are called late."""


@dataclass(frozen=True, slots=True)
class OwnRhythm:
    """Rhythm of the heart in the images.

    Attributes:
        rr_s: usual length of its beats.
        log_ratio: log-likelihood ratio of this rhythm against no cyclic motion, less its cost of wandering.
    """

    rr_s: float
    log_ratio: float

    def contradicts(self, ecg: EcgDelay) -> bool:
        """Whether the images' own rhythm explains them far better than the beats of the ECG at any delay."""
        return self.log_ratio - _log_ratio(ecg) > FOREIGN_LOG_RATIO


def best_stretch(
    images: ImageChange, lag_s: float, peaks_s: FloatArray, heart: CycleSpeed, own: OwnRhythm
) -> float | None:
    """Factor on the ECG's times with which it agrees with the images' own rhythm; None without one."""
    middle_s = 0.5 * (peaks_s[0] + peaks_s[-1])
    delays = [
        ecg_delay(images, lag_s, middle_s + factor * (peaks_s - middle_s), heart) for factor in STRETCHES
    ]
    ratios = [_log_ratio(one) for one in delays]
    best = int(np.argmax(ratios))
    return float(STRETCHES[best]) if own.log_ratio - ratios[best] < AGREES_LOG_RATIO else None


def _log_ratio(ecg: EcgDelay) -> float:
    return ecg.cyclic_log_ratio if np.isfinite(ecg.cyclic_log_ratio) else 0.0


def own_rhythm(images: ImageChange, lag_s: float, peaks_s: FloatArray, heart: CycleSpeed) -> OwnRhythm | None:
    """Search the rhythm of the images within the time of an ECG; None with too few images.

    Args:
        lag_s: t_tracker = t_video + lag_s.
        peaks_s: (k,) R peaks; only the first and the last are used.
    """
    t_s = images.t_s + lag_s
    inside = (t_s >= peaks_s[0]) & (t_s < peaks_s[-1])
    if np.count_nonzero(inside) < LEAST_PAIRS or not heart.speed.max() > 0:
        return None
    t_s, change, plain = t_s[inside], np.log(images.change[inside]), without_heart(images.moved_mm[inside])
    rhythms = []
    for rr_s in RATES_RR_S:
        cycles = (t_s - t_s[0]) / rr_s
        speeds = shifted_speeds(heart, cycles, images.step_s / rr_s)
        rhythms.append(OwnRhythm(float(rr_s), _followed(plain, change, speeds, np.floor(cycles).astype(int))))
    return max(rhythms, key=lambda one: one.log_ratio)


def _followed(plain: FloatArray, change: FloatArray, speeds: FloatArray, beat: IntArray) -> float:
    """Log-likelihood ratio of the best path of shifts against no cyclic motion, less the cost of the path.

    Args:
        speeds: (SHIFTS, n) root of the heart's speed at each pair of frames, for every shift of the cycle.
        beat: (n,) the metronome's beat of each pair.
    """
    beats, index = np.unique(beat, return_inverse=True)
    spread = WANDER * np.sqrt(np.diff(beats))
    half_n = 0.5 * min(0.5 * len(change), PAIRS_A_BEAT * len(beats))
    none = residual_of_fit(plain, change)[0]
    constant, _ = residuals_with(plain, speeds, change)
    best = 0.0
    for start in np.argsort(constant)[:STARTS]:
        path = np.full(len(beats), start)
        for _ in range(ROUNDS):
            left, fit = residual_of_fit(
                np.column_stack([plain, speeds[path[index], np.arange(len(change))]]), change
            )
            if fit[-1] <= 0:
                break
            steps = (np.diff(path) + SHIFTS // 2) % SHIFTS - SHIFTS // 2
            cost = float((0.5 * (steps / SHIFTS / spread) ** 2).sum())
            best = max(best, float(half_n * np.log(none / left)) - cost)
            squares = (change - plain @ fit[:-1] - fit[-1] * speeds) ** 2
            of_beat = np.array([np.bincount(index, row, len(beats)) for row in squares]).T
            again = _path(of_beat * half_n / left, spread)
            if np.array_equal(again, path):
                break
            path = again
    return best


def _path(costs: FloatArray, spread: FloatArray) -> IntArray:
    """(b,) shifts of least cost (b, SHIFTS) with that of their changes, which have these (b − 1,) spreads."""
    apart = np.abs(np.arange(SHIFTS)[:, None] - np.arange(SHIFTS)[None])
    apart = np.minimum(apart, SHIFTS - apart) / SHIFTS
    least, back = costs[0], list[NDArray[np.intp]]()
    for row, one in zip(costs[1:], spread, strict=True):
        total = least[:, None] + 0.5 * (apart / one) ** 2
        back.append(total.argmin(axis=0))
        least = total.min(axis=0) + row
    path = [int(least.argmin())]
    for before in reversed(back):
        path.append(int(before[path[-1]]))
    return np.array(path[::-1])
