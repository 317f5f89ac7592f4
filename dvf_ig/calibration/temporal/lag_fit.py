"""Fit and uncertainty of a lag between two recordings of one motion on two clocks."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.stats import t as student_t

from dvf_ig.core import BoolArray, FloatArray, read_only_arrays

_HALF_STEP_S = 0.01
"""Half width of the difference that gives a velocity: about half a tracker sample."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Motions:
    """The tracker's principal motion (mm) and the row (px), each on its own clock."""

    tracker_t_s: FloatArray
    motion_mm: FloatArray
    video_t_s: FloatArray
    row_px: FloatArray

    def correlation(self, lag_s: float) -> float:
        """Compute the signed correlation of row(t) with motion(t + lag)."""
        moved = self.moved_mm(lag_s)
        a, b = moved - moved.mean(), self.row_px - self.row_px.mean()
        scale = float(np.sqrt((a @ a) * (b @ b)))
        return float(a @ b) / scale if scale > 0 else 0.0

    def moved_mm(self, lag_s: float) -> FloatArray:
        """Interpolate the (n,) motion at the video's times plus the lag."""
        return np.interp(self.video_t_s + lag_s, self.tracker_t_s, self.motion_mm)

    def velocity_mm_s(self, lag_s: float) -> FloatArray:
        """Compute the (n,) rate of change of the motion at the video's times plus the lag."""
        rise = self.moved_mm(lag_s + _HALF_STEP_S) - self.moved_mm(lag_s - _HALF_STEP_S)
        return rise / (2 * _HALF_STEP_S)

    def line(self, lag_s: float) -> tuple[float, float, FloatArray]:
        """Fit gain (px/mm) and offset (px) of the row over the motion at a lag; also (n,) residuals (px)."""
        moved = self.moved_mm(lag_s)
        gain, offset = np.polyfit(moved, self.row_px, 1)
        return float(gain), float(offset), self.row_px - gain * moved - offset

    def part(self, keep: BoolArray) -> "Motions":
        return Motions(self.tracker_t_s, self.motion_mm, self.video_t_s[keep], self.row_px[keep])

    def frames_in(self, seconds: float) -> int:
        return max(1, round(seconds / float(np.median(np.diff(self.video_t_s)))))


def lag_interval(motions: Motions, lag_s: float, memory_s: float) -> tuple[float, float]:
    """Compute the lag's 95 % confidence interval for residuals correlated over `memory_s`.

    Gauss–Newton sensitivity J of the row to lag, gain and offset; covariance (JᵀJ)⁻¹ S (JᵀJ)⁻¹ with S the sum
    of the scores' autocovariances, so that slow sway of the hand and a drifting lag widen the interval.

    Source: Newey and West 1987 (Bartlett weights); 1.5 n/m degrees of freedom per Priestley 1981, table 6.1.
    """
    gain, _, residual = motions.line(lag_s)
    moved = motions.moved_mm(lag_s)
    sensitivity = np.column_stack([gain * motions.velocity_mm_s(lag_s), moved, np.ones(len(moved))])
    inverse = np.linalg.inv(sensitivity.T @ sensitivity)
    memory = motions.frames_in(memory_s)
    count, unknowns = sensitivity.shape
    total = _long_run_sum(sensitivity * residual[:, None], memory) * count / (count - unknowns)
    error = float(np.sqrt((inverse @ total @ inverse)[0, 0]))
    half_width = float(student_t.ppf(0.975, max(1.0, 1.5 * count / memory - 1))) * error
    return lag_s - half_width, lag_s + half_width


def excess_sigmas(motions: Motions, lag_s: float, other_s: float, memory_s: float) -> float:
    """Compute by how many standard errors squared residuals at `other_s` exceed those at `lag_s`.

    Source: Diebold and Mariano 1995, the mean of a difference of squared errors over its long-run error.
    """
    difference = motions.line(other_s)[2] ** 2 - motions.line(lag_s)[2] ** 2
    mean = float(difference.mean())
    total = float(_long_run_sum((difference - mean)[:, None], motions.frames_in(memory_s))[0, 0])
    return mean / (np.sqrt(total) / len(difference)) if total > 0 else 0.0


def period_lags(motions: Motions, lag_s: float) -> tuple[FloatArray, FloatArray]:
    """Fit a lag to each up-and-down movement: its middle (k,) on the video clock and its lag (k,).

    Gain is the recording's; lag and offset are each period's. Periods of fewer than 6 frames and periods
    that find no lag within a quarter of their length are left out.
    """
    gain, _, _ = motions.line(lag_s)
    above = motions.moved_mm(lag_s) > float(np.median(motions.motion_mm))
    edges = np.flatnonzero(above[1:] & ~above[:-1]) + 1
    middles, lags = [], []
    for first, stop in pairwise(edges.tolist()):
        own = motions.part(np.isin(np.arange(len(above)), np.arange(first, stop)))
        length_s = float(own.video_t_s[-1] - own.video_t_s[0])
        lag = _local_lag(own, lag_s, gain) if stop - first >= 6 else np.nan
        if abs(lag - lag_s) <= length_s / 4:
            middles.append(float(own.video_t_s.mean()))
            lags.append(lag)
    return np.array(middles), np.array(lags)


def _local_lag(motions: Motions, lag_s: float, gain: float) -> float:
    for _ in range(8):
        slope = gain * motions.velocity_mm_s(lag_s)
        missing = motions.row_px - gain * motions.moved_mm(lag_s)
        slope = slope - slope.mean()
        energy = float(slope @ slope)
        if energy == 0:
            return float("nan")
        lag_s += float(slope @ (missing - missing.mean())) / energy
    return lag_s


def _long_run_sum(scores: FloatArray, memory: int) -> FloatArray:
    """(k, k) sum over all pairs of samples of their expected product, from (n, k) scores of zero mean."""
    total = scores.T @ scores
    for shift in range(1, min(memory, len(scores) - 1) + 1):
        product = scores[shift:].T @ scores[:-shift]
        total = total + (1 - shift / (memory + 1)) * (product + product.T)
    return np.asarray(total)
