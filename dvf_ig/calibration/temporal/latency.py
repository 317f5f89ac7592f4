"""Temporal calibration: the lag between the tracker's clock and the video's, from one shared motion."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.signal import find_peaks
from scipy.stats import t as student_t

from dvf_ig.calibration.refusal import Gate, Refusal
from dvf_ig.core import (
    BoolArray,
    FloatArray,
    LatencyRecording,
    NoOverlapError,
    PoseStream,
    QualityGateError,
    read_only_arrays,
)

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


COMPARABLE_PERIODS = 0.5
"""Fewest up-and-down movements that can be compared at all."""
SEARCH_S = 0.5
"""Lags within ± this are tried."""
COARSE_S = 0.005
FINE_S = 0.001
"""Steps of the two searches; a parabola goes through the best three fine ones."""
MIN_PERIODS = 3.0
"""Fewest up-and-down movements accepted."""
MIN_MOTION_MM = 1.0
"""Smallest accepted standard deviation of the probe's principal motion."""
MIN_MOTION_PX = 2.0
"""Smallest accepted standard deviation of the line's row."""
MIN_CORRELATION = 0.8
"""Smallest accepted |correlation| at the best lag."""
MAX_SECOND_RATIO = 0.998
"""Largest accepted |correlation| of another lag over that of the best one."""
CLEAR_RATIO = 0.95
"""Another lag whose |correlation| is below this share of the best needs no further look; above it, it must
fit worse by MIN_SECOND_SIGMAS standard errors."""
MIN_SECOND_SIGMAS = 2.0
MEMORY_PERIODS = 2.0
"""Residuals further apart than this many movements count as independent."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class LatencyResult:
    """A lag with its evidence: t_tracker(event) = t_video(event) + lag_s.

    Attributes:
        lag_s: negative if the tracker leads the video.
        interval_s: 95 % confidence interval of lag_s, for residuals that are correlated in time.
        correlation: |Pearson correlation| of the two motions at lag_s.
        inverted: True if the row falls while the principal motion rises.
        second_lag_s, second_peak_ratio: the best other lag and its |correlation| over the winner's.
        second_sigmas: by how many standard errors that lag fits worse.
        halves_s: lags of the first and of the second half.
        periods: up-and-down movements in the recording.
        period_t_s, period_lags_s: (k,) middle of each movement on the video clock and the lag of it alone;
            a spread far beyond interval_s shows that the lag itself drifts (a frame grabber that is not
            synchronised with the scanner, filtered time stamps).
        lags_s, correlations: (k,) the signed correlation over all lags tried.
        motions: the two motions compared.
        refusals: the gates that the lag failed; it must not be used unless there are none.
    """

    lag_s: float
    interval_s: tuple[float, float]
    correlation: float
    inverted: bool
    second_lag_s: float
    second_peak_ratio: float
    second_sigmas: float
    halves_s: tuple[float, float]
    periods: float
    period_t_s: FloatArray
    period_lags_s: FloatArray
    lags_s: FloatArray
    correlations: FloatArray
    motions: Motions
    refusals: tuple[Refusal, ...] = ()

    @property
    def wander_s(self) -> float:
        """Standard deviation of the lags of single movements."""
        return float(self.period_lags_s.std(ddof=1)) if len(self.period_lags_s) > 1 else 0.0


def estimate_latency(recording: LatencyRecording) -> LatencyResult:
    """Estimate the lag at which the probe's principal motion best explains the line's row, of either sign.

    Args:
        recording: tracker_from_probe on the tracker clock, row of the tank bottom on the video clock.
    Raises:
        NoOverlapError: the two recordings share too little time.
        QualityGateError: there is no motion to compare. A lag from too few movements, of poor correlation, at
            the end of the search, or with a second lag that fits as well carries its refusals.
    Source: PLUS temporal calibration (principal axis against line position).
    Differs from source: of the two motion signs the better fit is kept, not the smaller lag.
    """
    motions = _motions(recording)
    periods = _periods(motions)
    refusals = _few_movements(periods)
    if periods < COMPARABLE_PERIODS:
        raise QualityGateError(refusals[0].detail)
    lags = np.arange(-SEARCH_S, SEARCH_S + COARSE_S / 2, COARSE_S)
    correlations = np.array([motions.correlation(float(lag)) for lag in lags])
    best = int(np.abs(correlations).argmax())
    lag, value = _refined(motions, float(lags[best]), float(np.sign(correlations[best])))
    memory_s = MEMORY_PERIODS * float(np.ptp(motions.video_t_s)) / periods
    second_lag, second = _second_peak(motions, lags, correlations, best)
    ratio = second / abs(value) if value else 1.0
    sigmas = excess_sigmas(motions, lag, second_lag, memory_s) if second else np.inf
    refusals += _poor(lag, abs(value)) + _second_lag(lag, second_lag, ratio, sigmas)
    sign = float(np.sign(value))
    early = np.arange(len(motions.video_t_s)) < len(motions.video_t_s) // 2
    halves = tuple(_refined(motions.part(keep), lag, sign)[0] for keep in (early, ~early))
    middles, own_lags = period_lags(motions, lag)
    return LatencyResult(
        lag_s=lag,
        interval_s=lag_interval(motions, lag, memory_s),
        correlation=abs(value),
        inverted=value < 0,
        second_lag_s=second_lag,
        second_peak_ratio=ratio,
        second_sigmas=sigmas,
        halves_s=(halves[0], halves[1]),
        periods=periods,
        period_t_s=middles,
        period_lags_s=own_lags,
        lags_s=lags,
        correlations=correlations,
        motions=motions,
        refusals=refusals,
    )


def principal_motion_mm(poses: PoseStream) -> FloatArray:
    """Compute (n valid,) translation along its principal axis, mm, zero mean; direction made unique."""
    translations = poses.translations_mm[poses.valid]
    centred = translations - translations.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    axis = axis * np.sign(axis[int(np.abs(axis).argmax())])
    return np.asarray(centred @ axis)


def _motions(recording: LatencyRecording) -> Motions:
    poses, rows = recording.tracker_from_probe, recording.wall_row_px
    first, last = rows.t_s[0] - SEARCH_S, rows.t_s[-1] + SEARCH_S
    near = poses.valid & (poses.t_s >= first - 1.0) & (poses.t_s <= last + 1.0)
    if near.sum() < 10:
        raise NoOverlapError(
            f"{poses.name} has {int(near.sum())} valid poses while the video ran ({rows.t_s[0]:.2f} to "
            f"{rows.t_s[-1]:.2f} s), needed at least 10; its own times run from {poses.t_s[0]:.2f} to "
            f"{poses.t_s[-1]:.2f} s: record both together on one clock"
        )
    nearby = PoseStream(
        poses.target, poses.source, poses.t_s[near], poses.rotations[near], poses.translations_mm[near],
        poses.valid[near],
    )  # fmt: skip
    covered = _covered(rows.t_s, nearby.t_s, SEARCH_S)
    if covered.sum() < 20:
        raise NoOverlapError(
            f"only {int(covered.sum())} of {len(rows.t_s)} video frames lie within the tracked time with "
            f"{SEARCH_S:g} s to spare on both sides, needed at least 20; let the tracker run longer"
        )
    motion = principal_motion_mm(nearby)
    row = rows.values[covered]
    if motion.std() < MIN_MOTION_MM or row.std() < MIN_MOTION_PX:
        raise QualityGateError(
            f"there is no motion to compare: the probe moves {motion.std():.2f} mm (needed "
            f"{MIN_MOTION_MM:g}) and the line {row.std():.2f} px (needed {MIN_MOTION_PX:g}), "
            "standard deviations; move the probe up and down above the tank's floor"
        )
    return Motions(nearby.t_s, motion, rows.t_s[covered], row)


def _covered(video_t_s: FloatArray, tracker_t_s: FloatArray, search_s: float) -> BoolArray:
    """Flag video frames with close tracker samples at every lag tried (no edges, gaps up to 0.25 s)."""
    inside = (video_t_s - search_s >= tracker_t_s[0]) & (video_t_s + search_s <= tracker_t_s[-1])
    for gap in np.flatnonzero(np.diff(tracker_t_s) > 0.25):
        inside &= (video_t_s + search_s < tracker_t_s[gap]) | (video_t_s - search_s > tracker_t_s[gap + 1])
    return np.asarray(inside)


def _periods(motions: Motions) -> float:
    """Half the number of times the row crosses its mean by more than a quarter of its spread."""
    level = motions.row_px - np.median(motions.row_px)
    side = np.where(np.abs(level) > 0.25 * level.std(), np.sign(level), 0.0)
    side = side[side != 0]
    return float(np.count_nonzero(np.diff(side)) / 2)


def _refined(motions: Motions, lag_s: float, sign: float) -> tuple[float, float]:
    """Refine the lag near `lag_s` for one sign of motion, by fine steps and a parabola."""
    steps = round(2 * COARSE_S / FINE_S)
    for _ in range(20):
        lags = lag_s + FINE_S * np.arange(-steps, steps + 1)
        values = sign * np.array([motions.correlation(float(lag)) for lag in lags])
        best = int(values.argmax())
        if 0 < best < len(lags) - 1:
            break
        lag_s = float(lags[best])
    else:
        return lag_s, sign * float(values[best])
    below, top, above = values[best - 1 : best + 2]
    bend = below - 2 * top + above
    offset = 0.5 * (below - above) / bend if bend < 0 else 0.0
    return float(lags[best] + offset * FINE_S), sign * float(top - 0.25 * (below - above) * offset)


def _second_peak(
    motions: Motions, lags: FloatArray, correlations: FloatArray, best: int
) -> tuple[float, float]:
    """Lag and |correlation| of the strongest other local maximum (NaN and 0 if there is none)."""
    strength = np.abs(correlations)
    peaks = find_peaks(np.concatenate([[-1.0], strength, [-1.0]]))[0] - 1
    others = peaks[np.abs(peaks - best) > 2]
    if len(others) == 0:
        return float("nan"), 0.0
    second = int(others[strength[others].argmax()])
    if second in (0, len(lags) - 1):
        return float(lags[second]), float(strength[second])
    lag, value = _refined(motions, float(lags[second]), float(np.sign(correlations[second])))
    return lag, abs(value)


def _few_movements(periods: float) -> tuple[Refusal, ...]:
    if periods >= MIN_PERIODS:
        return ()
    detail = (
        f"the recording holds {periods:.1f} up-and-down movements, needed at least {MIN_PERIODS:g}; "
        "move the probe up and down for ten seconds or more"
    )
    return (Refusal(Gate.FEW_MOVEMENTS, detail),)


def _poor(lag_s: float, correlation: float) -> tuple[Refusal, ...]:
    refusals = []
    if correlation < MIN_CORRELATION:
        detail = (
            f"probe and line move together with correlation {correlation:.2f} at best, needed at least "
            f"{MIN_CORRELATION:g}; check the line detection and that both belong to one recording"
        )
        refusals.append(Refusal(Gate.CORRELATION, detail))
    if abs(lag_s) >= SEARCH_S - COARSE_S:
        detail = (
            f"the best lag lies at the end of the search (±{SEARCH_S:g} s); check that both clocks "
            "are the same, or widen the search"
        )
        refusals.append(Refusal(Gate.END_OF_SEARCH, detail))
    return tuple(refusals)


def _second_lag(lag_s: float, second_lag_s: float, ratio: float, sigmas: float) -> tuple[Refusal, ...]:
    unclear = ratio > CLEAR_RATIO and sigmas < MIN_SECOND_SIGMAS
    if not (ratio > MAX_SECOND_RATIO or unclear):
        return ()
    detail = (
        f"two lags fit equally well ({lag_s:+.3f} s and {second_lag_s:+.3f} s, ratio {ratio:.3f}, "
        f"{sigmas:.1f} standard errors apart, needed {MIN_SECOND_SIGMAS:g}); "
        "record again with movements of uneven pace so that only one can match"
    )
    return (Refusal(Gate.SECOND_ANSWER, detail),)
